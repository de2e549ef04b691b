// SPDX-License-Identifier: Apache-2.0
// The scene in a headset, where the browser has WebXR: one metre is one metre, and the floor is the floor.

// The view of one eye of a headset, which has y up, from where the visitor entered the scene with a heading.
function eyeOfHeadset({ projectionMatrix: p, transform }, [width, height], [x, y], heading) {
  const { orientation: q, position } = transform, [cos, sin] = [Math.cos(heading), Math.sin(heading)];
  const world = [cos, -sin, 0, sin, cos, 0, 0, 0, 1], upright = (a) => turned(world, a[0], -a[2], a[1]);
  const m = rotation([q.w, q.x, q.y, q.z]), axis = (k, sign) => upright([m[k], m[k + 3], m[k + 6]]).map((v) => sign * v);
  const turn = [...axis(0, 1), ...axis(1, -1), ...axis(2, -1)], eye = plus(upright([position.x, position.y, position.z]), [x, y, 0]);
  return {
    wh: [width, height], focal: [(p[0] * width) / 2, (p[5] * height) / 2],
    principal: [(width * (1 - p[8])) / 2, (height * (1 + p[9])) / 2],
    rotation: turn, eye, offset: turned(turn, ...eye).map((value) => -value),
  };
}

// Shows the scene in a headset until its session ends; drawn at the pace of the headset, sorted as fast as can be.
async function enterHeadset(player) {
  const { scene, eye, state, painter } = player, { gl } = painter;
  const session = await navigator.xr.requestSession("immersive-vr", { requiredFeatures: ["local-floor"] });
  await gl.makeXRCompatible();
  const layer = new XRWebGLLayer(session, gl), space = await session.requestReferenceSpace("local-floor");
  session.updateRenderState({ baseLayer: layer, depthNear: scene.drawing.near });
  const { eye: place, rotation: turn } = eye.view([2, 2]), heading = Math.atan2(turn[7], turn[6]) - Math.PI / 2;
  let before = null, sorting = false, sorted = false;
  player.hold(true);
  session.addEventListener("end", () => player.hold(false));
  function draw(now, frame) {
    session.requestAnimationFrame(draw);
    if (state.playing && before !== null) player.advance(((now - before) / 1000) * scene.fps * state.speed);
    before = now;
    player.settle();
    const pose = frame.getViewerPose(space);
    if (!pose) return;
    pose.views.forEach((one, index) => {
      const { x, y, width, height } = layer.getViewport(one), view = eyeOfHeadset(one, [width, height], place, heading);
      if (!index && !sorting) {
        sorting = true;
        player.order(view).then((order) => { painter.setOrder(order); [sorting, sorted] = [false, true]; });
      }
      if (sorted) painter.draw(view, { tinted: state.tinted, surface: { buffer: layer.framebuffer, x, y } });
    });
  }
  session.requestAnimationFrame(draw);
}

async function offerHeadset(player) {
  const there = navigator.xr && (await navigator.xr.isSessionSupported("immersive-vr").catch(() => false));
  at("headset").hidden = !there;
  at("headset").onclick = () => enterHeadset(player).catch((error) => say(`The headset cannot be used: ${error.message}`));
}
