// SPDX-License-Identifier: Apache-2.0
// The view: free around a point or a person, from a training camera, or along a film.

const minus = (a, b) => a.map((value, k) => value - b[k]);
const plus = (a, b, times = 1) => a.map((value, k) => value + times * b[k]);
const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
const transposed = (m) => [0, 1, 2].flatMap((k) => [m[k], m[k + 3], m[k + 6]]);
const unit = (a) => a.map((value) => value / (Math.hypot(...a) || 1));

// Row-major camera_from_world of a level camera: x right, y down, z forward.
function looking(eye, target) {
  const forward = unit(minus(target, eye)), level = cross(forward, [0, 0, 1]);
  const right = Math.hypot(...level) < 1e-6 ? [1, 0, 0] : unit(level);
  return [...right, ...cross(forward, right), ...forward];
}

// The largest rectangle of aspect `own` in a canvas: left, top, and scale.
function fitted(wh, own) {
  const times = Math.min(wh[0] / own[0], wh[1] / own[1]);
  return [(wh[0] - times * own[0]) / 2, (wh[1] - times * own[1]) / 2, times];
}

// A camera of size `own` on a canvas: its whole picture, and its surroundings.
function onCanvas(wh, own, focal, principal, turn, eye) {
  const [left, top, times] = fitted(wh, own), offset = turned(turn, ...eye).map((value) => -value);
  const middle = [principal[0] * times + left, principal[1] * times + top];
  return { wh, focal: focal.map((f) => f * times), principal: middle, rotation: turn, eye, offset };
}

function makeEye(scene) {
  const first = scene.cameras[0].wh;
  // As wide as the training cameras on average; zoom is a multiple of it, as in films.
  const wide = ({ intrinsics: k, wh }) => (k[0][0] + k[1][1]) / 2 / wh[0];
  const usual = scene.cameras.reduce((sum, camera) => sum + wide(camera) / scene.cameras.length, 0);
  const poses = scene.cameras.map(({ camera_from_world: m }) => {
    const turn = m.slice(0, 3).flatMap((row) => row.slice(0, 3)), back = transposed(turn);
    return { turn, eye: turned(back, m[0][3], m[1][3], m[2][3]).map((value) => -value) };
  });
  const start = poses[0].eye, reach = Math.hypot(...minus(start, scene.centre)) || 3;
  const home = { mode: "free", eye: start, target: scene.centre, zoom: 1, camera: 0, film: 0, picture: 0, person: null };
  const eye = { ...home };

  function row(film, picture) {
    const steps = scene.films[film].steps, first_ = within(Math.round(picture), 0, steps.length / 14 - 1) * 14;
    return Array.from(steps.subarray(first_, first_ + 14));
  }

  return Object.assign(eye, {
    usual, wide,
    reset: () => Object.assign(eye, home),
    pictures: (film) => scene.films[film].steps.length / 14,
    frameOf: (film, picture) => row(film, picture)[13],
    // The view on a canvas; it targets the pelvis of a followed person.
    view(wh) {
      if (eye.mode === "camera") {
        const { intrinsics: k, wh: own } = scene.cameras[eye.camera], { turn, eye: place } = poses[eye.camera];
        return onCanvas(wh, own, [k[0][0], k[1][1]], [k[0][2], k[1][2]], turn, place);
      }
      if (eye.mode === "film") {
        const [w, h, fx, fy, cx, cy, qw, qx, qy, qz, x, y, z] = row(eye.film, eye.picture);
        return onCanvas(wh, [w, h], [fx, fy], [cx, cy], transposed(rotation([qw, qx, qy, qz])), [x, y, z]);
      }
      const focal = eye.zoom * usual * first[0], middle = first.map((side) => side / 2);
      return onCanvas(wh, first, [focal, focal], middle, looking(eye.eye, eye.target), eye.eye);
    },
    // Frees the view from a camera or a film, at the same pose.
    letGo() {
      if (eye.mode === "free") return;
      const { rotation: turn, eye: place, focal } = eye.view(first), forward = turn.slice(6);
      const ahead = minus(scene.centre, place).reduce((sum, value, k) => sum + value * forward[k], 0);
      Object.assign(eye, { mode: "free", eye: place, zoom: focal[0] / usual / first[0], person: null });
      eye.target = plus(place, forward, Math.max(ahead, 0.3 * reach));
    },
    orbit(across, down) {
      eye.letGo();
      const from = minus(eye.eye, eye.target), far = Math.hypot(...from);
      const azimuth = Math.atan2(from[1], from[0]) - across, high = within(Math.asin(from[2] / far) + down, -1.55, 1.55);
      const flat = Math.cos(high);
      eye.eye = plus(eye.target, [flat * Math.cos(azimuth), flat * Math.sin(azimuth), Math.sin(high)], far);
    },
    // Moves target and eye together: metres to the right, down and ahead.
    fly(right, down, ahead) {
      eye.letGo();
      const step = turned(transposed(looking(eye.eye, eye.target)), right, down, ahead);
      Object.assign(eye, { eye: plus(eye.eye, step), target: plus(eye.target, step), person: null });
    },
    // Scales the distance to the target; below 1 is nearer.
    nearer(times) {
      eye.letGo();
      const from = minus(eye.eye, eye.target);
      eye.eye = plus(eye.target, unit(from), within(Math.hypot(...from) * times, 0.3, 20 * reach));
    },
    // Orbits a point; the distance between eye and target stays.
    follow(place) {
      eye.letGo();
      Object.assign(eye, { eye: plus(eye.eye, minus(place, eye.target)), target: [...place] });
    },
  });
}
