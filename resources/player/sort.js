// SPDX-License-Identifier: Apache-2.0
// The order in which Gaussians are drawn, the furthest first, after bones have moved them. Runs in a worker of its own.

// It uses nothing else: the worker is created from its source text.
function makeSorter() {
  let sets = [], size = 0, depths, ids, order, counts;

  // sets: [{first, count, means, bones, shares, firstBone, weights}]
  function load(given) {
    sets = given;
    size = sets.reduce((sum, set) => sum + set.count, 0);
    depths = new Float32Array(size);
    ids = new Uint32Array(size);
    order = [new Uint32Array(size), new Uint32Array(size)];
    counts = new Uint32Array(65536);
  }

  // Writes those of the Gaussians from..end of a set that cover most of the picture from `to` on: returns their end,
  // and the factor on their size that makes them cover as much as all.
  function strongest(set, from, end, share, to) {
    const weights = new Float32Array(end - from), bits = new Uint32Array(weights.buffer);
    let all = 0, kept = 0, bin = 4096, part = 0;
    for (let i = from; i < end; i++) all += weights[i - from] = set.weights[ids[i] - set.first] / depths[i] ** 2;
    // Positive floats have the order of their bits; of the last bin, an evenly spread part is taken.
    const bins = new Uint32Array(4096);
    for (const own of bits) bins[own >>> 20]++;
    for (let left = share * (end - from); left > 0 && bin; left -= bins[bin]) part = Math.min(left / bins[--bin], 1);
    for (let i = from, due = 0; i < end; i++) {
      const own = bits[i - from] >>> 20;
      if (own === bin) due += part;
      if (own < bin || (own === bin && due < 1)) continue;
      if (own === bin) due--;
      kept += weights[i - from];
      [ids[to], depths[to++]] = [ids[i], depths[i]];
    }
    return [to, kept > 0 ? Math.sqrt(all / kept) : 1];
  }

  // Ids of Gaussians further than `near` along the row (x, y, z, offset) of a camera, the furthest first: all, or
  // `most` of those inside the `sides` of the picture (rows of the same form).
  function sorted({ row, sides, matrices, shown, near, most }) {
    const grow = sets.map(() => 1), ends = [0];
    let count = 0;
    sets.forEach((set, index) => {
      ends[index + 1] = count;
      if (!shown[index]) return;
      const { means, bones, shares, first } = set, own = new Float32Array(1024);
      const [x, y, z, offset] = row;
      // The product of a bone's row and the camera's: depth is linear in a Gaussian's rest position.
      for (let b = 0; bones && b < matrices.length / 12 - set.firstBone; b++) {
        const m = (set.firstBone + b) * 12;
        for (let k = 0; k < 4; k++)
          own[4 * b + k] = x * matrices[m + k] + y * matrices[m + 4 + k] + z * matrices[m + 8 + k];
        own[4 * b + 3] += offset;
      }
      for (let i = 0; i < set.count; i++) {
        const px = means[3 * i], py = means[3 * i + 1], pz = means[3 * i + 2];
        let depth = x * px + y * py + z * pz + offset;
        if (bones) {
          depth = 0;
          for (let k = 4 * i; k < 4 * i + 4; k++) {
            const b = 4 * bones[k];
            if (shares[k]) depth += (shares[k] / 255) * (own[b] * px + own[b + 1] * py + own[b + 2] * pz + own[b + 3]);
          }
        }
        if (!(depth > near)) continue;
        // Moving sets count as inside.
        if (!bones && sides && sides.some((s) => s[0] * px + s[1] * py + s[2] * pz + s[3] < 0)) continue;
        depths[count] = depth;
        ids[count++] = first + i;
      }
      ends[index + 1] = count;
    });
    if (count > most) {
      const share = most / count;
      count = 0;
      sets.forEach((set, k) => ([count, grow[k]] = strongest(set, ends[k], ends[k + 1], share, count)));
    }
    // Positive floats have the order of their bits: two rounds of 16 bits.
    const keys = new Uint32Array(depths.buffer, 0, size);
    let from = null;
    for (let shift = 0, round = 0; round < 2; shift += 16, round++) {
      counts.fill(0);
      for (let i = 0; i < count; i++) counts[(keys[i] >>> shift) & 65535]++;
      for (let i = 0, sum = 0; i < 65536; i++) [counts[i], sum] = [sum, sum + counts[i]];
      const to = order[round];
      for (let i = 0; i < count; i++) {
        const place = from ? from[i] : i;
        to[counts[(keys[place] >>> shift) & 65535]++] = place;
      }
      from = to;
    }
    const furthest = new Uint32Array(count);
    for (let i = 0; i < count; i++) furthest[i] = ids[from[count - 1 - i]];
    return { ids: furthest, grow };
  }
  return { load, sorted };
}

// A worker that sorts, or the page itself without workers. Called with a view, it returns a promise of the order.
function startSorter(sets) {
  const names = ["first", "count", "means", "bones", "shares", "firstBone", "weights"];
  const given = sets.map((set) => Object.fromEntries(names.map((name) => [name, set[name]])));
  const text = `const sorter = (${makeSorter})();
    onmessage = ({ data }) => {
      if (data.sets) return sorter.load(data.sets);
      const order = sorter.sorted(data);
      postMessage(order, [order.ids.buffer]);
    };`;
  let worker;
  try {
    worker = new Worker(URL.createObjectURL(new Blob([text], { type: "text/javascript" })));
  } catch (refused) {
    const sorter = makeSorter();
    sorter.load(given);
    return async (view) => sorter.sorted(view);
  }
  worker.postMessage({ sets: given });
  let last = Promise.resolve();
  const asked = (view) =>
    new Promise((done) => {
      worker.onmessage = ({ data }) => done(data);
      worker.postMessage(view);
    });
  return (view) => (last = last.then(() => asked(view)));
}
