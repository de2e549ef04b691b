// SPDX-License-Identifier: Apache-2.0
// The page's data as arrays: Gaussians of every set (the room, people, things), and poses of bones at a time.

// Texels in a row of every texture with one texel per Gaussian; every set begins a new row.
const ROW = 1024;
const within = (value, low, high) => Math.min(Math.max(value, low), high);

// The bytes behind all descriptions: gzip in base64.
async function bytesOf(text) {
  const packed = Uint8Array.from(atob(text.trim()), (letter) => letter.charCodeAt(0));
  const stream = new Blob([packed]).stream().pipeThrough(new DecompressionStream("gzip"));
  return new Response(stream).arrayBuffer();
}

// Numbers of a description, row by row.
function numbers(bytes, { at, count, columns, bits, low, high }) {
  const raw = new Uint8Array(bytes, at, (count * columns * bits) / 8);
  const found = low ? new Float32Array(count * columns) : new Uint32Array(count * columns);
  const planes = bits / 8, steps = 2 ** bits - 1;
  for (let column = 0; column < columns; column++) {
    const from = low ? low[column] : 0, step = low ? (high[column] - low[column]) / steps : 1;
    for (let i = 0; i < count; i++) {
      let value = 0;
      for (let k = 0; k < planes; k++) value = value * 256 + raw[(column * planes + k) * count + i];
      found[i * columns + column] = from + step * value;
    }
  }
  return found;
}

// Unit quaternions (w, x, y, z): two bits for the index of the largest number, ten for each of the others.
function quaternions(packed) {
  const found = new Float32Array(packed.length * 4);
  for (let i = 0; i < packed.length; i++) {
    const largest = packed[i] >>> 30;
    let rest = 1;
    for (let k = 0; k < 3; k++) {
      const value = (((packed[i] >>> (20 - 10 * k)) & 1023) / 1022 - 0.5) * Math.SQRT2;
      found[i * 4 + ((largest + 1 + k) % 4)] = value;
      rest -= value * value;
    }
    found[i * 4 + largest] = Math.sqrt(Math.max(rest, 0));
  }
  return found;
}

// A description with its packed arrays unpacked; deliver/packing.py writes it.
function unpacked(bytes, described) {
  if (!described || typeof described !== "object") return described;
  const { packed, at, count, columns } = described;
  if (packed === "file") return new Uint8Array(bytes, at, count);
  if (packed === "floats") return new Float32Array(bytes, at, count * columns);
  if (packed) return packed === "turns" ? quaternions(numbers(bytes, described)) : numbers(bytes, described);
  for (const name in described) described[name] = unpacked(bytes, described[name]);
  return described;
}

// The scene of a page's description; sets get the index of their first Gaussian and bone in the shared arrays.
function readScene(described, bytes) {
  const data = unpacked(bytes, described);
  let first = 0, bone = 0;
  for (const set of data.sets) {
    set.first = first;
    first += Math.ceil(set.count / ROW) * ROW;
    set.bands = (set.degree + 1) ** 2 - 1;
    set.scales = set.scales.map(Math.exp);
    set.shown = true;
    // Area of the picture that a Gaussian covers at one metre: its two longest axes and its opacity.
    set.weights = set.opacities.map((opacity, i) => {
      const [, b, c] = set.scales.slice(3 * i, 3 * i + 3).sort();
      return opacity * b * c;
    });
    if (set.motion) {
      set.firstBone = bone;
      bone += set.motion.parents.length;
      set.joints = new Float32Array(set.motion.parents.length * 3);
    }
  }
  return { ...data, size: first, bones: new Float32Array(Math.max(bone, 1) * 12) };
}

// The moments before and after a time in an ascending list, and the share of the way between them.
function between(place, count) {
  const at = within(place, 0, count - 1), low = Math.min(Math.floor(at), Math.max(count - 2, 0));
  return [low, Math.min(low + 1, count - 1), at - low];
}

function slerp(values, low, high, share) {
  let dot = 0;
  for (let k = 0; k < 4; k++) dot += values[low + k] * values[high + k];
  const sign = dot < 0 ? -1 : 1, angle = Math.acos(Math.min(Math.abs(dot), 1));
  const a = angle < 1e-4 ? 1 - share : Math.sin((1 - share) * angle) / Math.sin(angle);
  const b = sign * (angle < 1e-4 ? share : Math.sin(share * angle) / Math.sin(angle));
  return rotation([0, 1, 2, 3].map((k) => a * values[low + k] + b * values[high + k]));
}

// Row-major rotation matrix of a quaternion (w, x, y, z) of any length.
function rotation(q) {
  const length = Math.hypot(...q) || 1, [w, x, y, z] = q.map((value) => value / length);
  return [
    1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y),
    2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x),
    2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y),
  ];
}

// The product of two row-major matrices, column by column.
const times = (a, b) => transposed([0, 1, 2].flatMap((k) => turned(a, b[k], b[k + 3], b[k + 6])));

function turned(r, x, y, z) {
  return [r[0] * x + r[1] * y + r[2] * z, r[3] * x + r[4] * y + r[5] * z, r[6] * x + r[7] * y + r[8] * z];
}

// Poses of a set's bones at a frame: writes world_from_rest (3 x 4 per bone) into `out`, joints into the set.
// Rotations are interpolated spherically, as in body/avatar.
function move(scene, set, frame, out) {
  const { parents, rest, turns, places, present } = set.motion;
  let [low, high, share] = between((frame * (scene.moments - 1)) / Math.max(scene.frames - 1, 1), scene.moments);
  if (present) {
    // Next to a moment in which it is away, a thing or person keeps the pose of the nearer moment.
    const near = share > 0.5 ? high : low;
    set.there = present[near] > 0;
    if (present[low] !== present[high]) [low, high, share] = present[low] ? [low, low, 0] : [high, high, 0];
  } else set.there = true;
  const world = [], joints = set.joints;
  for (let j = 0; j < parents.length; j++) {
    const at = (low * parents.length + j) * 4, next = (high * parents.length + j) * 4, parent = parents[j];
    const own = slerp(turns, at, next, share);
    world[j] = parent < 0 ? own : times(world[parent], own);
    if (parent < 0) {
      for (let k = 0; k < 3; k++) joints[3 * j + k] = (1 - share) * places[3 * low + k] + share * places[3 * high + k];
    } else {
      const bone = turned(world[parent], ...[0, 1, 2].map((k) => rest[3 * j + k] - rest[3 * parent + k]));
      for (let k = 0; k < 3; k++) joints[3 * j + k] = joints[3 * parent + k] + bone[k];
    }
    const carried = turned(world[j], rest[3 * j], rest[3 * j + 1], rest[3 * j + 2]);
    for (let row = 0; row < 3; row++) {
      const to = (set.firstBone + j) * 12 + row * 4;
      for (let k = 0; k < 3; k++) out[to + k] = world[j][row * 3 + k];
      out[to + 3] = joints[3 * j + row] - carried[row];
    }
  }
}

// Whether a set was measured at a frame; an interpolated pose makes all of it inferred.
function measuredAt(set, frame) {
  return !set.motion || set.motion.valid[within(Math.round(frame), 0, set.motion.valid.length - 1)] > 0;
}

// Change of a set's colours at a frame: four numbers per Gaussian. A person's are added (colour, logit); the room's
// first one is a factor. Null for a set that never changes.
function changesAt(scene, set, frame, out) {
  if (set.shade) {
    const { at, times: moments, factors } = set.shade, count = at.length;
    let low = 0;
    while (low < moments.length - 2 && moments[low + 1] <= frame) low++;
    const high = Math.min(low + 1, moments.length - 1), gap = moments[high] - moments[low];
    const share = gap > 0 ? within((frame - moments[low]) / gap, 0, 1) : 0;
    for (let i = 0; i < count; i++)
      out[4 * at[i]] = (1 - share) * factors[low * count + i] + share * factors[high * count + i];
    return true;
  }
  if (!set.changes) return false;
  const { near, shares, values, moments } = set.changes, columns = values.length / moments;
  const [low, high, share] = between((frame * (moments - 1)) / Math.max(scene.frames - 1, 1), moments);
  const now = new Float32Array(columns);
  for (let k = 0; k < columns; k++)
    now[k] = (1 - share) * values[low * columns + k] + share * values[high * columns + k];
  for (let i = 0; i < set.count * 4; i += 4) {
    for (let channel = 0; channel < 4; channel++) {
      let sum = 0;
      for (let k = 0; k < 4; k++) sum += (shares[i + k] / 255) * now[near[i + k] * 4 + channel];
      out[i + channel] = sum;
    }
  }
  return true;
}
