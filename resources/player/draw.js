// SPDX-License-Identifier: Apache-2.0
// WebGL2: the scene's textures, updated where it moves, and the picture from a view.

// Texels in a row of the harmonics' texture.
const WIDE = 4096;

function program(gl, vertex, fragment) {
  const made = gl.createProgram();
  for (const [kind, source] of [[gl.VERTEX_SHADER, vertex], [gl.FRAGMENT_SHADER, fragment]]) {
    const shader = gl.createShader(kind);
    gl.shaderSource(shader, source);
    gl.compileShader(shader);
    if (!gl.getShaderParameter(shader, gl.COMPILE_STATUS)) throw new Error(gl.getShaderInfoLog(shader));
    gl.attachShader(made, shader);
  }
  gl.linkProgram(made);
  if (!gl.getProgramParameter(made, gl.LINK_STATUS)) throw new Error(gl.getProgramInfoLog(made));
  const at = {};
  for (let i = 0; i < gl.getProgramParameter(made, gl.ACTIVE_UNIFORMS); i++) {
    const { name } = gl.getActiveUniform(made, i);
    at[name] = gl.getUniformLocation(made, name);
  }
  return { made, at };
}

// One array of four numbers per Gaussian for all sets, one set after the other.
function together(scene, Kind, fill) {
  const all = new Kind((scene.size / ROW || 1) * ROW * 4);
  scene.sets.forEach((set, index) => {
    for (let i = 0, to = set.first * 4; i < set.count; i++, to += 4) fill(set, i, all.subarray(to, to + 4), index);
  });
  return all;
}

function makePainter(canvas, scene) {
  const gl = canvas.getContext("webgl2", { antialias: false, alpha: false, preserveDrawingBuffer: true });
  if (!gl) return null;
  const most = gl.getParameter(gl.MAX_TEXTURE_SIZE), bands = Math.max(...scene.sets.map((set) => set.bands));
  if (scene.size / ROW > most || (scene.size * bands) / WIDE > most)
    throw new Error(`this graphics card holds ${most} rows of Gaussians, too few for this scene`);
  // Half floats resolve many faint layers; without them, eight bits are used.
  const fine = !!(gl.getExtension("EXT_color_buffer_float") || gl.getExtension("EXT_color_buffer_half_float"));
  const splats = program(gl, SPLAT_VERTEX, SPLAT_FRAGMENT), show = program(gl, SHOW_VERTEX, SHOW_FRAGMENT);
  const units = {};

  function smooth(how) {
    for (const side of [gl.TEXTURE_MIN_FILTER, gl.TEXTURE_MAG_FILTER]) gl.texParameteri(gl.TEXTURE_2D, side, how);
  }
  function texture(name, kind, width, data, unit = Object.keys(units).length) {
    const formats = {
      float: [gl.RGBA32F, gl.RGBA, gl.FLOAT], byte: [gl.RGBA8, gl.RGBA, gl.UNSIGNED_BYTE],
      whole: [gl.RGBA16UI, gl.RGBA_INTEGER, gl.UNSIGNED_SHORT], id: [gl.R32UI, gl.RED_INTEGER, gl.UNSIGNED_INT],
    };
    const [inside, format, type] = formats[kind], made = gl.createTexture();
    const height = data.length / (kind === "id" ? 1 : 4) / width;
    gl.activeTexture(gl.TEXTURE0 + unit);
    gl.bindTexture(gl.TEXTURE_2D, made);
    smooth(gl.NEAREST);
    gl.texImage2D(gl.TEXTURE_2D, 0, inside, width, height, 0, format, type, data);
    units[name] = { unit, renew: (rows, from, first) => {
      gl.activeTexture(gl.TEXTURE0 + unit);
      gl.texSubImage2D(gl.TEXTURE_2D, 0, 0, first, width, rows, format, type, from);
    } };
  }

  // The first numbers of each Gaussian of a set, followed by others.
  const own = (name, count, behind = () => []) => together(scene, Float32Array, (set, i, to, index) =>
    to.set([...set[name].subarray(count * i, count * i + count), ...behind(set, i, index)]));
  texture("means", "float", ROW, own("means", 3, (set, i) => [set.opacities[i]]));
  texture("turns", "float", ROW, own("quaternions", 4));
  texture("scales", "float", ROW, own("scales", 3, (set, i, index) => [index * 4 + set.provenance[i]]));
  texture("colours", "float", ROW, own("colours", 3));
  texture("skins", "whole", ROW, together(scene, Uint16Array, (set, i, to) => {
    for (let k = 0; set.bones && k < 4; k++) to[k] = set.bones[4 * i + k] + 256 * set.shares[4 * i + k];
  }));
  const shaped = new Uint8Array(Math.max(Math.ceil((scene.size * bands) / WIDE), 1) * WIDE * 4);
  for (const set of scene.sets) {
    for (let i = 0; i < set.count; i++) for (let b = 0; b < set.bands; b++) for (let c = 0; c < 3; c++)
      shaped[((set.first + i) * bands + b) * 4 + c] = set.harmonics[(i * set.bands + b) * 3 + c];
  }
  texture("harmonics", "byte", WIDE, shaped);
  const changing = scene.sets.some((set) => set.changes || set.shade);
  const unchanged = (set, i, to) => to.set([set.motion ? 0 : 1, 0, 0, 0]);
  const changed = changing ? together(scene, Float32Array, unchanged) : new Float32Array(4);
  texture("changes", "float", changing ? ROW : 1, changed);
  // Rows of 3 x 4 numbers: three texels per bone.
  texture("bones", "float", 3, scene.bones);
  // Two texels per set, one below the other.
  const aboutSets = new Float32Array(scene.sets.length * 8);
  texture("sets", "float", scene.sets.length, aboutSets);
  const order = new Uint32Array(scene.size);
  texture("order", "id", ROW, order);
  // Quads of one list: without a graphics card an instance for every Gaussian takes several times as long.
  gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, gl.createBuffer());
  const corners = new Uint32Array(scene.size * 6).map((_, k) => 4 * Math.floor(k / 6) + [0, 1, 2, 2, 1, 3][k % 6]);
  gl.bufferData(gl.ELEMENT_ARRAY_BUFFER, corners, gl.STATIC_DRAW);
  gl.disable(gl.DEPTH_TEST);

  // Buffers for blending: colours, and shares of measured, inferred and invented.
  const layers = ["picture", "shares"].map((name) => ({ name, unit: 10 + (name === "shares"), wh: [0, 0] }));
  function target(layer, [width, height]) {
    gl.activeTexture(gl.TEXTURE0 + layer.unit);
    if (layer.wh[0] !== width || layer.wh[1] !== height) {
      gl.deleteTexture(layer.texture);
      gl.deleteFramebuffer(layer.buffer);
      layer.texture = gl.createTexture();
      gl.bindTexture(gl.TEXTURE_2D, layer.texture);
      const levels = Math.floor(Math.log2(Math.max(width, height))) + 1;
      gl.texStorage2D(gl.TEXTURE_2D, levels, fine ? gl.RGBA16F : gl.RGBA8, width, height);
      smooth(gl.LINEAR);
      gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MIN_FILTER, gl.LINEAR_MIPMAP_NEAREST);
      layer.buffer = gl.createFramebuffer();
      gl.bindFramebuffer(gl.FRAMEBUFFER, layer.buffer);
      gl.framebufferTexture2D(gl.FRAMEBUFFER, gl.COLOR_ATTACHMENT0, gl.TEXTURE_2D, layer.texture, 0);
      layer.wh = [width, height];
    }
    gl.bindFramebuffer(gl.FRAMEBUFFER, layer.buffer);
    gl.viewport(0, 0, width, height);
  }

  let count = 0, fence = null;
  const named = gl.getExtension("WEBGL_debug_renderer_info");
  const card = gl.getParameter(named ? named.UNMASKED_RENDERER_WEBGL : gl.RENDERER);
  return {
    gl, fine, software: /swiftshader|llvmpipe|softpipe|software|basic render/i.test(card),
    // Ids of Gaussians, the furthest first, and how much each set's Gaussians grow to replace omitted ones.
    setOrder({ ids, grow }) {
      count = ids.length;
      order.set(ids);
      units.order.renew(Math.ceil(count / ROW), order, 0);
      grow.forEach((times, index) => (aboutSets[(scene.sets.length + index) * 4] = times));
      units.sets.renew(2, aboutSets, 0);
    },
    // The number of Gaussians of the next picture, and whether the previous one is still being drawn.
    count: () => count,
    busy: () => !!fence && gl.getSyncParameter(fence, gl.SYNC_STATUS) !== gl.SIGNALED,
    // Uploads bones and colours of a frame; the scene's matrices are those of that frame.
    setMoment(frame) {
      units.bones.renew(scene.bones.length / 12, scene.bones, 0);
      scene.sets.forEach((set, index) => {
        const bone = set.motion ? set.firstBone + 1 : 0, rows = Math.ceil(set.count / ROW);
        aboutSets.set([bone, measuredAt(set, frame) ? 1 : 0, set.bands, set.reach], index * 4);
        const part = changed.subarray(set.first * 4, (set.first + rows * ROW) * 4);
        if (changing && changesAt(scene, set, frame, part)) units.changes.renew(rows, part, set.first / ROW);
      });
      units.sets.renew(2, aboutSets, 0);
    },
    // A view: {wh, focal, principal, rotation (row-major camera_from_world), offset, eye}; exposure: three factors.
    // Draws the part of the order from `from` to `to`; the picture is shown once its last part is drawn.
    draw(view, { exposure = [1, 1, 1], tinted = false, hurried = false, scale = 1, from = 0, to = count, surface } = {}) {
      const [width, height] = view.wh, small = view.wh.map((side) => Math.max(1, Math.round(side * scale)));
      const { at, made } = splats, by = [small[0] / width, small[1] / height], { drawing } = scene;
      const focal = view.focal.map((f, k) => f * by[k]), principal = view.principal.map((c, k) => c * by[k]);
      gl.useProgram(made);
      for (const [name, { unit }] of Object.entries(units)) if (at[name]) gl.uniform1i(at[name], unit);
      gl.uniformMatrix3fv(at.camera, true, view.rotation);
      for (const name of ["offset", "eye"]) gl.uniform3fv(at[name], view[name]);
      for (const [name, two] of Object.entries({ focal, principal, size: small })) gl.uniform2fv(at[name], two);
      gl.uniform4fv(at.limits, [0, 1].flatMap((k) => {
        const margin = drawing.margin * small[k];
        return [(-principal[k] - margin) / focal[k], (small[k] - principal[k] + margin) / focal[k]];
      }));
      for (const name of ["near", "dilation", "faintest", "strongest"]) gl.uniform1f(at[name], drawing[name]);
      gl.uniform1i(at.bands, bands);
      gl.uniform1i(at.changing, changing);
      gl.enable(gl.BLEND);
      gl.blendFunc(gl.ONE, gl.ONE_MINUS_SRC_ALPHA);
      for (const layer of tinted ? layers : layers.slice(0, 1)) {
        target(layer, small);
        gl.clearColor(0, 0, 0, 0);
        if (!from) gl.clear(gl.COLOR_BUFFER_BIT);
        gl.uniform1i(at.classes, layer.name === "shares");
        gl.drawElements(gl.TRIANGLES, 6 * (Math.min(to, count) - from), gl.UNSIGNED_INT, 24 * from);
      }
      if (fence) gl.deleteSync(fence);
      if (to >= count) this.show(hurried ? small : view.wh, exposure, tinted, hurried, surface);
      fence = gl.fenceSync(gl.SYNC_GPU_COMMANDS_COMPLETE, 0);
      gl.flush();
    },
    // On the canvas, or on a part of another surface, such as a headset's.
    show([width, height], exposure, tinted, hurried, { buffer = null, x = 0, y = 0 } = {}) {
      if (!buffer && (canvas.width !== width || canvas.height !== height)) [canvas.width, canvas.height] = [width, height];
      gl.disable(gl.BLEND);
      gl.bindFramebuffer(gl.FRAMEBUFFER, buffer);
      gl.viewport(x, y, width, height);
      gl.useProgram(show.made);
      gl.uniform1i(show.at.picture, layers[0].unit);
      gl.uniform1i(show.at.shares, tinted ? layers[1].unit : layers[0].unit);
      gl.uniform2f(show.at.size, width, height);
      gl.uniform2f(show.at.corner, x, y);
      gl.uniform3fv(show.at.exposure, exposure);
      gl.uniform1i(show.at.tinted, tinted);
      gl.uniform1i(show.at.hurried, hurried);
      gl.activeTexture(gl.TEXTURE0 + layers[0].unit);
      if (hurried) gl.generateMipmap(gl.TEXTURE_2D);
      gl.drawArrays(gl.TRIANGLES, 0, 3);
    },
    // The canvas's pixels, rows from the top: four bytes per pixel.
    read() {
      const { width, height } = canvas, row = width * 4, raw = new Uint8Array(row * height), upright = raw.slice();
      gl.readPixels(0, 0, width, height, gl.RGBA, gl.UNSIGNED_BYTE, raw);
      for (let y = 0; y < height; y++) upright.set(raw.subarray((height - 1 - y) * row, (height - y) * row), y * row);
      return upright;
    },
  };
}
