// SPDX-License-Identifier: Apache-2.0
// The player: the current moment and view, sorting and redrawing, and overlays on the picture.

const SLOW = "No graphics card: while moving, only part of the scene is drawn.";
const at = (id) => document.getElementById(id);

function say(text, seconds = 4) {
  at("message").textContent = text;
  if (seconds) setTimeout(() => at("message").textContent === text && (at("message").textContent = ""), 1000 * seconds);
}

function makePlayer(scene, painter) {
  const eye = makeEye(scene), sorter = startSorter(scene.sets), stage = at("stage");
  const lines = at("lines").getContext("2d");
  const calm = matchMedia("(prefers-reduced-motion: reduce)").matches, last = scene.frames - 1;
  const state = { frame: 0, playing: !calm && last > 0, speed: 1, loop: true, opacity: 0.5, bright: true };
  Object.assign(state, { tinted: false, skeletons: false });
  const files = scene.cameras.map(() => null), flying = { right: 0, down: 0, ahead: 0 };
  // Numbers of changes: of those made, those drawn, those sorted for and those that the panel shows.
  let changes = 1, drawn = 0, sorted = 0, shown = 0, sorting = false, fresh = false, still = false;
  let before = 0, moved = NaN, noted = 0, pictures = 0;
  // The view that is drawn, when its drawing began, and of the whole picture how many Gaussians are drawn.
  let seen = { due: 0 }, begun = null, whole = Infinity;
  // So many Gaussians are drawn within the goal: twenty pictures a second; without a graphics card five, of which
  // sorting, at the same processor, leaves two to three.
  const goal_ms = painter.software ? 200 : 50;
  let most = painter.software ? 20000 : 4 * scene.size, slice = most;
  // Fewer than a sixteenth of the Gaussians show nothing recognisable.
  const paced = (was, could) => within((was + could) / 2, scene.size / 16, 4 * scene.size);
  const changed = () => changes++;

  const pixels = (side) => Math.max(Math.round(side * Math.min(devicePixelRatio || 1, 2)), 2);
  const size = () => [stage.clientWidth, stage.clientHeight].map(pixels);

  // Moves everything to the current moment, and the view along with a followed person.
  function settle() {
    if (eye.mode === "film") state.frame = eye.frameOf(eye.film, eye.picture);
    if (moved === state.frame) return;
    moved = state.frame;
    for (const set of scene.sets) if (set.motion) move(scene, set, state.frame, scene.bones);
    painter.setMoment(state.frame);
    const followed = eye.mode === "free" && scene.sets.find((set) => set.name === eye.person);
    if (followed) eye.follow(Array.from(followed.joints.subarray(0, 3)));
  }

  // The order in which to draw a view: all of it, or as many Gaussians as there is time for.
  function order(view, most = Infinity) {
    const [x, y, z] = [0, 1, 2].map((k) => [...view.rotation.slice(3 * k, 3 * k + 3), view.offset[k]]);
    // A fifth beyond the picture on every side: what is large reaches in.
    const side = (row, k, share, sign) =>
      row.map((value, i) => sign * (value - ((share * view.wh[k] - view.principal[k]) / view.focal[k]) * z[i]));
    return sorter({
      row: z, matrices: scene.bones.slice(), near: scene.drawing.near, most,
      sides: most < Infinity && [side(x, 0, -0.2, 1), side(x, 0, 1.2, -1), side(y, 1, -0.2, 1), side(y, 1, 1.2, -1)],
      shown: scene.sets.map((set) => set.shown && (!set.motion || set.there)),
    });
  }

  // Factors of a camera's exposure at this moment.
  function exposure() {
    const factors = state.bright && eye.mode === "camera" && scene.cameras[eye.camera].exposure;
    if (!factors) return [1, 1, 1];
    const row = factors.length === 3 ? 0 : Math.min(Math.round(state.frame), last);
    return Array.from(factors.subarray(3 * row, 3 * row + 3));
  }

  // The picture of this exact moment, sorted and drawn, for screenshots and checks.
  async function picture(options = {}) {
    still = true;
    settle();
    const view = eye.view(options.wh || size());
    painter.setOrder(await order(view));
    painter.draw(view, { exposure: options.exposure || exposure(), tinted: state.tinted });
    const pixels = painter.read();
    still = false;
    changed();
    return { width: view.wh[0], height: view.wh[1], pixels };
  }

  function pixelOf(view, point) {
    const [x, y, z] = plus(turned(view.rotation, ...point), view.offset);
    return z > scene.drawing.near && [x, y].map((value, k) => (view.focal[k] * value) / z + view.principal[k]);
  }

  function drawSkeletons(view) {
    const { canvas } = lines, [width, height] = view.wh;
    if (canvas.width !== width || canvas.height !== height) [canvas.width, canvas.height] = [width, height];
    lines.clearRect(0, 0, width, height);
    lines.lineWidth = Math.max(2, width / 500);
    scene.sets.filter((set) => state.skeletons && set.kind === "person" && set.shown).forEach((set, index) => {
      if (!set.there) return;
      lines.strokeStyle = `hsl(${(index * 137 + 200) % 360} 90% 65%)`;
      set.motion.parents.forEach((parent, j) => {
        const ends = [parent, j].map((k) => k >= 0 && pixelOf(view, set.joints.subarray(3 * k, 3 * k + 3)));
        if (!ends[0] || !ends[1]) return;
        lines.beginPath();
        lines.moveTo(...ends[0]);
        lines.lineTo(...ends[1]);
        lines.stroke();
      });
    });
  }

  // The camera's footage over the rendering: its film, or the photo nearest in time.
  function drawFilmed() {
    const { film, photos, wh } = scene.cameras[eye.camera], standing = eye.mode === "camera" && (film || photos);
    const [shown, other] = film ? [at("film"), at("photo")] : [at("photo"), at("film")];
    other.style.visibility = "hidden";
    shown.style.visibility = standing && state.opacity > 0 ? "visible" : "hidden";
    if (!standing) return at("film").pause();
    const addressOf = (file, type) => URL.createObjectURL(new Blob([file], { type }));
    files[eye.camera] ||= film ? [addressOf(film, "video/mp4")] : photos.map(({ file }) => addressOf(file, "image/jpeg"));
    const gaps = film ? [0] : photos.map(({ frame }) => Math.abs(frame - state.frame));
    const address = files[eye.camera][gaps.indexOf(Math.min(...gaps))];
    if (shown.src !== address) shown.src = address;
    const [left, top, times] = fitted([stage.clientWidth, stage.clientHeight], wh);
    const box = { left, top, width: times * wh[0], height: times * wh[1] };
    for (const side in box) shown.style[side] = `${box[side]}px`;
    shown.style.opacity = state.opacity;
    if (!film) return;
    // Another camera's film breaks off the loading of this one: no fault. A film that cannot be played has an error.
    if (state.playing && shown.paused) shown.play().catch(() => {});
    if (!state.playing) shown.pause();
    shown.playbackRate = state.speed;
    const wanted = (state.frame + 0.5) / scene.fps, allowed = state.playing ? 0.15 : 0.3 / scene.fps;
    if (!shown.seeking && Math.abs(shown.currentTime - wanted) > allowed) shown.currentTime = wanted;
  }

  const end = () => (eye.mode === "film" ? eye.pictures(eye.film) - 1 : last);
  const place = () => (eye.mode === "film" ? eye.picture : state.frame);
  function seek(value) {
    if (eye.mode === "film") eye.picture = within(value, 0, end());
    else state.frame = within(value, 0, end());
    changed();
  }

  function advance(by) {
    const next = place() + by;
    if (next > end() && !state.loop) state.playing = false;
    seek(next > end() && state.loop ? next % (end() + 1) : next);
  }

  function sort(number, refining = false) {
    sorting = true;
    order(seen.view, number).then((found) => {
      if (!still) painter.setOrder(found);
      [sorting, sorted, fresh] = [false, seen.due, !refining];
    });
  }

  function paint(now, options) {
    const { from = 0, to = Infinity } = options;
    begun = { now, count: Math.min(to, painter.count()) - from, sorted, part: to < Infinity };
    painter.draw(seen.view, { exposure: exposure(), tinted: state.tinted, ...options });
  }

  // The picture is complete: adapts the number of Gaussians to its time, and hides the poster.
  function finish(now) {
    const could = (begun.count * goal_ms) / Math.max(now - begun.now, 1);
    if (begun.part) slice = paced(slice, could);
    else most = paced(most, could);
    if (begun.sorted) [at("picture").hidden, at("poster").hidden, pictures] = [false, true, pictures + 1];
    begun = null;
  }

  // The next thing to draw. Where there is no time for all Gaussians, those that matter most are drawn, sorted for the
  // very moment and in fewer pixels; once nothing moves, all of them, a part at a time.
  function drawOn(now) {
    if (painter.busy()) return;
    if (begun) finish(now);
    const hurried = most < scene.size;
    if (hurried && sorting) return;
    if (seen.due !== changes && !(hurried && fresh)) {
      settle();
      seen = { due: changes, view: eye.view(size()) };
    }
    if (sorted !== seen.due && !sorting) sort(most);
    if (hurried && sorting) return;
    if (drawn !== seen.due || fresh) {
      paint(now, { hurried, scale: hurried ? Math.max(2 ** (Math.round(Math.log2(most / scene.size)) / 2), 0.25) : 1 });
      drawSkeletons(seen.view);
      [drawn, fresh, whole] = [seen.due, false, hurried ? -1 : Infinity];
    } else if (whole < 0) {
      whole = 0;
      sort(Infinity, true);
    } else if (!sorting && whole < painter.count()) {
      paint(now, { from: whole, to: whole + Math.round(slice) });
      whole += Math.round(slice);
    }
  }

  function tick(now) {
    requestAnimationFrame(tick);
    const passed = Math.min((now - before) / 1000, 1);
    before = now;
    if (still) return;
    if (flying.right || flying.down || flying.ahead) {
      eye.fly(...Object.values(flying).map((speed) => speed * passed));
      changed();
    }
    if (state.playing) advance(passed * scene.fps * state.speed);
    drawFilmed();
    drawOn(now);
    if (shown !== changes) player.shown();
    shown = changes;
    if (now > noted + 500) {
      noted = now;
      writeLink(player);
    }
  }

  const player = {
    scene, painter, eye, state, flying, keys: [], last, changed, picture, pixelOf, seek, end, place, advance, settle, order,
    shown: () => {},
    // While something else draws the scene, this page does not.
    hold: (on) => { still = on; changed(); },
    play: () => { state.playing = !state.playing && end() > 0; changed(); },
    reset: () => { eye.reset(); changed(); },
    full: () => (document.fullscreenElement ? document.exitFullscreen() : document.documentElement.requestFullscreen()),
    help: () => (at("keys").open ? at("keys").close() : at("keys").showModal()),
    addKey: () => addKey(player),
    shot: (name) => shotText(player.keys, name),
    step: (by) => { state.playing = false; seek(Math.round(place()) + by); },
    drawn: () => drawn,
    pictures: () => pictures,
    rested: () => drawn === changes && whole >= painter.count(),
    begin() {
      at("film").onerror = () => say("this browser cannot play the cameras' films");
      settle();
      readLink(player);
      requestAnimationFrame(tick);
    },
  };
  return player;
}
