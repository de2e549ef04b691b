// SPDX-License-Identifier: Apache-2.0
// The player inside another page: a scene of another address, and messages that set and report time and view.

const asked = new URLSearchParams(location.search);

// The page whose scene is shown: this one, or with ?src= another player of the same server, of which only data is read.
async function sourcePage() {
  const src = asked.get("src");
  if (!src) return document;
  const answer = await fetch(src).catch(() => { throw new Error("?src= needs a page of the same server"); });
  if (!answer.ok) throw new Error(`${src} is not there (${answer.status})`);
  const page = new DOMParser().parseFromString(await answer.text(), "text/html");
  if (!page.getElementById("scene") || !page.getElementById("bytes")) throw new Error(`${src} is no player of a scene`);
  at("poster").src = page.getElementById("poster").getAttribute("src");
  document.title = page.title;
  return page;
}

// Answers the page around this one: if it is of the same server, or of the site that ?origin= names. Its messages are
// {studiorecon: "get"} and {studiorecon: "set", view, time_s, playing}, with the entries of a link as `view`.
function answerParent(player) {
  const { scene, eye, state, last, changed } = player, host = asked.get("origin") || location.origin;
  if (parent === window || host === "null") return;
  let listening = false, sent = "";
  function report(kind) {
    const { frame, playing } = state, view = Object.fromEntries(linkOf(player)), names = (list) => list.map((one) => one.name);
    const people = names(scene.sets.filter((set) => set.kind === "person")), about = { people, frames: last + 1, fps: scene.fps };
    Object.assign(about, { scene: scene.scene, cameras: names(scene.cameras), films: names(scene.films) });
    const message = { studiorecon: kind, view, frame, time_s: frame / scene.fps, playing, mode: eye.mode, ...about };
    if (kind !== "state" || JSON.stringify(message) !== sent) parent.postMessage(message, host);
    sent = JSON.stringify({ ...message, studiorecon: "state" });
  }
  addEventListener("message", ({ data, origin, source }) => {
    if (source !== parent || origin !== host || !data || !["get", "set"].includes(data.studiorecon)) return;
    listening = true;
    if (data.studiorecon === "set") {
      const link = linkOf(player), given = Object.entries(Object(data.view)), { playing } = state;
      if (given.some(([name]) => ["camera", "film", "eye"].includes(name)))
        for (const name of ["camera", "film", "picture", "eye", "target", "zoom", "follow"]) link.delete(name);
      for (const [name, value] of given) link.set(name, value);
      if (Number.isFinite(data.time_s)) link.set("frame", data.time_s * scene.fps);
      applyLink(player, link);
      state.playing = (typeof data.playing === "boolean" ? data.playing : playing) && player.end() > 0;
      changed();
    }
    report("state");
  });
  setInterval(() => listening && report("state"), 100);
  report("ready");
}
