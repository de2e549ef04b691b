// SPDX-License-Identifier: Apache-2.0
// Buttons and boxes: cameras, films, people and objects, provenance, saving, and the time bar.

const LEVELS = [
  ["rgb(70 130 180)", "measured: a camera saw it"], ["rgb(240 200 80)", "inferred from what was seen"],
  ["rgb(200 80 70)", "invented: no camera saw it"],
];

function makePanel(player) {
  const { scene, eye, state, keys, changed } = player, panel = at("panel").querySelector("details"), refresh = [];

  function add(parent, tag, textContent = "", also = {}) {
    const made = Object.assign(document.createElement(tag), { textContent }, also);
    parent.append(made);
    return made;
  }
  const section = (title) => add(panel, "h2", title) && add(panel, "div");
  function button(parent, text, does, pressed) {
    const made = add(parent, "button", text, { onclick: () => { does(); changed(); } });
    if (pressed) refresh.push(() => made.setAttribute("aria-pressed", pressed()));
  }
  function box(parent, text, of, name) {
    const label = add(parent, "label"), input = add(label, "input", "", { type: "checkbox" });
    input.onchange = () => { of[name] = input.checked; changed(); };
    label.append(text);
    refresh.push(() => (input.checked = of[name]));
    return label;
  }
  async function copy(text, done, otherwise) {
    const asked = navigator.clipboard ? navigator.clipboard.writeText(text) : Promise.reject();
    say(await asked.then(() => done, () => otherwise));
  }
  // A button for each entry, pressed while its view is active.
  function buttons(parent, mode, list, also = {}) {
    list.forEach(({ name }, index) => {
      const chosen = () => eye.mode === mode && eye[mode] === index;
      button(parent, name, () => Object.assign(eye, { mode, [mode]: index, ...also }), chosen);
    });
  }

  // On a phone the picture comes first: the title opens the controls.
  panel.open = !matchMedia("(max-width: 640px)").matches;
  at("panel").querySelector("h1").textContent = scene.scene;
  const cameras = section("View from camera");
  buttons(cameras, "camera", scene.cameras);
  const photo = add(panel, "label", "photo"), opacity = add(photo, "input", "", { type: "range", min: 0, max: 1 });
  Object.assign(opacity, { step: 0.01, value: state.opacity });
  opacity.oninput = () => { state.opacity = +opacity.value; changed(); };
  const bright = box(panel, "match the photo's brightness", state, "bright");
  refresh.push(() => {
    photo.style.display = eye.mode === "camera" ? "" : "none";
    bright.style.display = eye.mode === "camera" && scene.cameras[eye.camera].exposure ? "" : "none";
  });
  const films = section("Fly along film");
  buttons(films, "film", scene.films, { picture: 0 });
  button(films, "free", () => eye.letGo(), () => eye.mode === "free");
  const who = section("People and objects");
  for (const set of scene.sets) box(who, set.name, set, "shown");
  const known = section("Provenance");
  box(known, "truth map", state, "tinted");
  for (const [colour, text] of LEVELS)
    add(known, "p", text, { className: "level" }).style.setProperty("--colour", colour);
  if (scene.sets.some((set) => set.kind === "person")) box(known, "skeletons", state, "skeletons");

  const keep = section("Save");
  button(keep, "Screenshot", async () => {
    await player.picture();
    const download = `${scene.scene}-${state.frame.toFixed(1)}.png`;
    const save = (href) => Object.assign(document.createElement("a"), { href, download }).click();
    at("picture").toBlob((file) => save(URL.createObjectURL(file)));
  });
  button(keep, "Link", () => {
    writeLink(player);
    copy(location.href, "the link is copied", "the address bar has the link");
  });
  const path = section("Film a path"), shot = add(panel, "textarea", "", { readOnly: true, hidden: true });
  shot.setAttribute("aria-label", "The path as an entry of render.shots");
  refresh.push(() => {
    const text = keys.length > 1 ? shotText(keys) : "add one more key for a path";
    shot.hidden = !keys.length;
    if (shot.value !== text) shot.value = text;
  });
  button(path, "Add key", () => addKey(player));
  button(path, "Remove last", () => keys.pop());
  button(path, "Copy", () => {
    shot.select();
    copy(shot.value, "copied: an entry of render.shots", "the text is selected: copy it");
  });
  const about = add(panel, "details");
  add(about, "summary", "About this view");
  const list = add(about, "ul"), { software, fine } = player.painter;
  const coarse = !fine && "this browser blends in 8 bits: faint layers show steps";
  for (const sentence of [...scene.notes, software && SLOW, coarse]) if (sentence) add(list, "li", sentence);

  at("play").onclick = player.play;
  at("slider").oninput = () => { state.playing = false; player.seek(+at("slider").value); };
  at("speed").onchange = () => (state.speed = +at("speed").value);
  for (const name of ["reset", "full", "help"]) at(name).onclick = player[name];
  at("full").hidden = !document.fullscreenEnabled;
  at("loop").onclick = () => at("loop").setAttribute("aria-pressed", (state.loop = !state.loop));
  player.shown = () => {
    const { frame } = state, which = eye.mode === "film" ? `picture ${Math.round(eye.picture)}, ` : "";
    Object.assign(at("slider"), { max: player.end(), value: player.place() });
    const seconds = (frame / scene.fps).toFixed(2);
    at("clock").textContent = `${which}frame ${frame.toFixed(1)} of ${player.last}, ${seconds} s`;
    at("play").textContent = state.playing ? "❚❚" : "▶";
    at("play").setAttribute("aria-label", state.playing ? "Pause" : "Play");
    refresh.forEach((update) => update());
  };
}
