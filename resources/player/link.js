// SPDX-License-Identifier: Apache-2.0
// The view as text: in the page's address, and as an entry of render.shots.

function linkOf({ scene, eye, state }) {
  const three = (values) => values.map((value) => value.toFixed(3)).join(","), link = new URLSearchParams();
  if (eye.mode === "camera") link.set("camera", scene.cameras[eye.camera].name);
  else if (eye.mode === "film") {
    link.set("film", scene.films[eye.film].name);
    link.set("picture", Math.round(eye.picture));
  } else {
    for (const name of ["eye", "target"]) link.set(name, three(eye[name]));
    link.set("zoom", eye.zoom.toFixed(4));
  }
  if (!state.playing) link.set("frame", state.frame.toFixed(2));
  if (eye.person) link.set("follow", eye.person);
  const hidden = scene.sets.filter((set) => !set.shown).map((set) => set.name);
  if (hidden.length) link.set("hide", hidden);
  for (const name of ["tinted", "skeletons"]) if (state[name]) link.set(name, 1);
  return link;
}

function writeLink(player) {
  const link = `${linkOf(player)}`;
  if (location.hash.slice(1) !== link) history.replaceState(null, "", `#${link}`);
}

// Applies an address; entries for people or cameras that do not exist are ignored.
function applyLink({ scene, eye, state, last, changed }, link) {
  const number = (name) => (link.has(name) ? +link.get(name) : NaN);
  const index = (list, name) => list.findIndex((one) => one.name === link.get(name));
  const camera = index(scene.cameras, "camera"), film = index(scene.films, "film"), frame = number("frame");
  const [place, target] = ["eye", "target"].map((name) => (link.get(name) || "").split(",").map(Number));
  if (camera >= 0) Object.assign(eye, { mode: "camera", camera });
  else if (film >= 0)
    Object.assign(eye, { mode: "film", film, picture: within(number("picture") || 0, 0, eye.pictures(film) - 1) });
  else if ([place, target].every((one) => one.length === 3 && one.every(Number.isFinite)))
    Object.assign(eye, { mode: "free", eye: place, target, zoom: within(number("zoom") || 1, 0.05, 20) });
  if (Number.isFinite(frame)) Object.assign(state, { frame: within(frame, 0, last), playing: false });
  const named = (name) => scene.sets.some((set) => set.kind === "person" && set.name === name);
  eye.person = named(link.get("follow")) ? link.get("follow") : null;
  for (const set of scene.sets) set.shown = !(link.get("hide") || "").split(",").includes(set.name);
  for (const name of ["tinted", "skeletons"]) state[name] = link.has(name);
  changed();
}

const readLink = (player) => applyLink(player, new URLSearchParams(location.hash.slice(1)));

// The current view as a key of a path. Between keys time runs at its own speed; if it is the same, the camera takes a
// second.
function addKey({ scene, eye, state, keys }) {
  const before = keys.at(-1), { frame } = state, waits = Math.max(Math.round(scene.fps), 1);
  const picture = before ? before.picture + (Math.round(Math.abs(frame - before.frame)) || waits) : 0;
  const camera = eye.mode === "camera" && scene.cameras[eye.camera];
  if (camera) return keys.push({ picture, camera: camera.name, frame, zoom: eye.wide(camera) / eye.usual });
  eye.letGo();
  keys.push({ picture, eye: [...eye.eye], target: eye.person || [...eye.target], frame, zoom: eye.zoom });
}

// Keys as an entry of render.shots: level cameras that face a point or a person, or the pose of a camera.
function shotText(keys, name = "mine") {
  const three = (values) => `[${values.map((value) => value.toFixed(3)).join(", ")}]`;
  const lines = keys.map(({ picture, camera, eye, target, frame, zoom }) => {
    const aim = () => `eye_m: ${three(eye)}, target: ${typeof target === "string" ? target : three(target)}`;
    const place = camera === undefined ? aim() : `camera: ${JSON.stringify(camera)}`;
    return `      - {picture: ${picture}, ${place}, frame: ${+frame.toFixed(2)}, zoom: ${+zoom.toFixed(4)}}`;
  });
  return ["render:", "  shots:", `    ${name}:`, "      kind: spline", "      keys:", ...lines, ""].join("\n");
}
