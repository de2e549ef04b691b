// SPDX-License-Identifier: Apache-2.0
// Mouse, touch and keys, and the start of the player.

const FLY_MPS = 2;
const WAYS = { d: ["right", 1], a: ["right", -1], q: ["down", 1], e: ["down", -1], w: ["ahead", 1], s: ["ahead", -1] };

function listen(player) {
  const { scene, eye, state, flying, changed, pixelOf } = player, stage = at("stage"), fingers = new Map();

  function drag(event) {
    const was = fingers.get(event.pointerId);
    if (!was) return;
    const high = stage.clientHeight, [dx, dy] = [event.clientX - was.clientX, event.clientY - was.clientY];
    const metres = () => Math.hypot(...minus(eye.eye, eye.target)) / high;
    const pan = (share) => eye.fly(-share * dx * metres(), -share * dy * metres(), 0);
    const other = [...fingers.values()].find((one) => one.pointerId !== event.pointerId);
    if (other) {
      const gap = (one) => Math.hypot(one.clientX - other.clientX, one.clientY - other.clientY) || 1;
      eye.nearer(gap(was) / gap(event));
      pan(0.5);
    } else if (event.shiftKey || event.buttons & 6) pan(1);
    else eye.orbit((3 * dx) / high, (3 * dy) / high);
    fingers.set(event.pointerId, event);
    changed();
  }

  // Follows the person nearest to the clicked pixel.
  function choose(event) {
    const view = eye.view([stage.clientWidth, stage.clientHeight]), here = stage.getBoundingClientRect();
    let best = 0.1 * stage.clientHeight, found = null;
    for (const set of scene.sets.filter((one) => one.kind === "person" && one.shown && one.there)) {
      for (let j = 0; j < set.joints.length; j += 3) {
        const pixel = pixelOf(view, set.joints.subarray(j, j + 3));
        const off = pixel && [pixel[0] - event.clientX + here.left, pixel[1] - event.clientY + here.top];
        const gap = off ? Math.hypot(...off) : best;
        if (gap < best) [best, found] = [gap, set];
      }
    }
    if (!found) return;
    eye.follow(Array.from(found.joints.subarray(0, 3)));
    eye.person = found.name;
    changed();
  }

  const toggle = (name) => () => (state[name] = !state[name]);
  const keys = {
    " ": player.play, ArrowLeft: () => player.step(-1), ArrowRight: () => player.step(1), 0: () => eye.letGo(),
    t: toggle("tinted"), k: toggle("skeletons"), r: player.reset, f: player.full,
  };
  function press(event) {
    // A focused control keeps its own keys.
    const own = event.target.matches("button, summary, input") && [" ", "ArrowLeft", "ArrowRight"].includes(event.key);
    if (own || event.ctrlKey || event.metaKey || event.altKey || event.target.matches("textarea, select")) return;
    const key = event.key.length === 1 ? event.key.toLowerCase() : event.key, camera = +key - 1;
    if (key === "?") return player.help();
    if (WAYS[key]) flying[WAYS[key][0]] = WAYS[key][1] * FLY_MPS;
    else if (keys[key]) keys[key]();
    else if (scene.cameras[camera]) Object.assign(eye, { mode: "camera", camera });
    else return;
    event.preventDefault();
    changed();
  }

  const on = (name, does, options) => stage.addEventListener(name, does, options);
  on("pointerdown", (event) => { stage.setPointerCapture(event.pointerId); fingers.set(event.pointerId, event); });
  on("pointermove", drag);
  for (const name of ["pointerup", "pointercancel"]) on(name, (event) => fingers.delete(event.pointerId));
  on("contextmenu", (event) => event.preventDefault());
  const roll = (event) => { event.preventDefault(); eye.nearer(Math.exp(event.deltaY / 800)); changed(); };
  on("wheel", roll, { passive: false });
  on("dblclick", choose);
  addEventListener("keydown", press);
  addEventListener("keyup", ({ key }) => { const [way] = WAYS[key.toLowerCase()] || []; if (way) flying[way] = 0; });
  addEventListener("blur", () => Object.assign(flying, { right: 0, down: 0, ahead: 0 }));
  addEventListener("resize", changed);
  addEventListener("hashchange", () => readLink(player));
}

async function start() {
  const films = "this is a picture of it; the films in the same folder show it";
  if (!window.DecompressionStream) return say(`This browser is too old to unpack the scene; ${films}.`, 0);
  const held = await sourcePage(), [bytes, about] = ["bytes", "scene"].map((id) => held.getElementById(id).textContent);
  const scene = readScene(JSON.parse(about), await bytesOf(bytes));
  const painter = makePainter(at("picture"), scene);
  if (!painter) return say(`This browser has no WebGL2, so you cannot move through the scene; ${films}.`, 0);
  at("picture").addEventListener("webglcontextlost", () => {
    [at("picture").hidden, at("poster").hidden] = [true, false];
    say("The graphics card stopped (too little memory?): reload this page, or watch the films in the same folder.", 0);
  });
  for (const id of ["panel", "time"]) at(id).hidden = false;
  const player = (window.player = makePlayer(scene, painter));
  makePanel(player);
  listen(player);
  player.begin();
  answerParent(player);
  offerHeadset(player);
  at("bytes").remove();
  if (at("stage").clientWidth < 640) at("panel").querySelector("details").open = false;
  say(painter.software ? SLOW : "", 8);
}

start().catch((error) => say(`The scene cannot be shown: ${error.message}`, 0));
