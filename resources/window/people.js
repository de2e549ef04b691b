// SPDX-License-Identifier: Apache-2.0
// Who is who, corrected by clicks: the cameras side by side with boxes and names, and a timeline for each person.

import { button, get, make, path, post, say, tried } from "./dom.js";
import { showProject } from "./project.js";

// As on the identity page: distinguishable for colour-blind readers.
const COLOURS = ["#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#8c6bb1", "#4d4d4d"];
const colour = (person) => (person ? COLOURS[+person.slice(1) % COLOURS.length] : "#8a8f98");

export async function showPeople(place, name) {
  const { fps, frames, tracks: given, cameras } = await get(`identities/${path(name)}`);
  const past = [];
  let tracks = given, chosen = -1, frame = 0, playing = false;
  const people = () => [...new Set(tracks.map((one) => one.person).filter(Boolean))].sort((a, b) => a.slice(1) - b.slice(1));
  // The part of a whole track that a frame belongs to: of those that have begun the last one.
  const whole = (one) => one.track.split("@")[0], begins = (one) => +(one.track.split("@")[1] || -1);
  const part = (camera, track) => tracks.map((one, k) => [one, k])
    .filter(([one]) => one.camera === camera && whole(one) === track && begins(one) <= frame)
    .sort(([a], [b]) => begins(b) - begins(a))[0][1];

  // One change, which can be undone.
  function change(next) {
    past.push(tracks);
    tracks = next;
    draw();
  }
  const rename = (person) => change(tracks.map((one, k) => (k === chosen ? { ...one, person } : one)));
  // The part before ``from``, and the other one, whose person is ``later``.
  const cut = (one, from, later) => (one.first >= from ? [{ ...one, person: later }]
    : [{ ...one, last: from - 1 }, { ...one, first: from, track: `${whole(one)}@${from}`, person: later }]);
  function recut(which, from, later, { camera, ...old } = tracks[chosen]) {
    change(tracks.flatMap((one) => (one.last >= from && which(one) ? cut(one, from, later(one)) : [one])));
    chosen = part(camera, whole(old));
    draw();
  }
  const split = (old = tracks[chosen]) => recut((one) => one === old, frame, (one) => one.person);
  const swap = (person, from, { camera, person: own } = tracks[chosen]) =>
    recut((one) => one.camera === camera && [own, person].includes(one.person), from, (one) => (one.person === own ? person : own));
  const fresh = () => `p${1 + Math.max(-1, ...people().map((one) => +one.slice(1)))}`;

  const views = cameras.map(({ name: camera, wh, boxes }) => {
    const film = make("video", "", { src: `api/film/${path(name, camera)}`, muted: true, playsInline: true, preload: "auto" });
    const canvas = make("canvas", "", { width: wh[0], height: wh[1] }), seen = new Map();
    for (const [track, list] of Object.entries(boxes))
      for (const [at, ...box] of list) seen.set(at, [...(seen.get(at) || []), [track, box]]);
    canvas.onclick = ({ offsetX, offsetY }) => {
      const x = (offsetX * wh[0]) / canvas.clientWidth, y = (offsetY * wh[1]) / canvas.clientHeight;
      const size = ([, [a, b, c, d]]) => (c - a) * (d - b);
      const hit = (seen.get(frame) || []).filter(([, [a, b, c, d]]) => a <= x && x <= c && b <= y && y <= d);
      chosen = hit.length ? part(camera, hit.sort((a, b) => size(a) - size(b))[0][0]) : -1;
      draw();
    };
    film.style.aspectRatio = `${wh[0]} / ${wh[1]}`;
    return { camera, film, canvas, seen, wh, place: make("div", "", { className: "view" }, film, canvas, make("b", camera)) };
  });

  function boxes({ camera, canvas, seen, wh }) {
    const pen = canvas.getContext("2d"), unit = Math.max(wh[0] / 320, 1);
    pen.clearRect(0, 0, ...wh);
    pen.font = `bold ${Math.round(13 * unit)}px system-ui, sans-serif`;
    for (const [track, [a, b, c, d]] of seen.get(frame) || []) {
      const k = part(camera, track), { person } = tracks[k];
      pen.lineWidth = (k === chosen ? 4 : 2) * unit;
      pen.strokeStyle = pen.fillStyle = colour(person);
      pen.setLineDash(person ? [] : [4 * unit, 3 * unit]);
      pen.strokeRect(a, b, c - a, d - b);
      const text = person || "nobody", wide = pen.measureText(text).width + 6 * unit, top = Math.max(b - 17 * unit, 0);
      pen.fillRect(a, top, wide, 17 * unit);
      pen.fillStyle = "#fff";
      pen.fillText(text, a + 3 * unit, top + 13 * unit);
    }
  }

  const slider = make("input", "", { type: "range", min: 0, max: frames - 1, value: 0 }), clock = make("span", "", { className: "soft" });
  slider.setAttribute("aria-label", "Frame");
  function seek(next) {
    frame = Math.max(0, Math.min(frames - 1, Math.round(next)));
    slider.value = frame;
    clock.textContent = `frame ${frame} of ${frames - 1}`;
    if (!playing) for (const { film } of views) film.currentTime = (frame + 0.5) / fps;
    views.forEach(boxes);
    if (!playing) tell();
  }
  function follow() {
    if (!playing || !place.isConnected) return;
    seek(Math.floor(views[0].film.currentTime * fps));
    requestAnimationFrame(follow);
  }
  const play = button("▶", () => {
    playing = !playing;
    play.textContent = playing ? "❚❚" : "▶";
    for (const { film } of views) if (playing) { film.loop = true; film.play().catch(() => {}); } else film.pause();
    if (playing) follow(); else seek(frame);
  });
  play.setAttribute("aria-label", "Play or pause");
  slider.oninput = () => { if (playing) play.click(); seek(+slider.value); };

  const tools = make("div", "", { className: "card" }), lines = make("div"), jobs = make("div");
  function tell() {
    const one = tracks[chosen], also = (person) => ({ style: `border-color:${colour(person)}` });
    tools.replaceChildren(...(one ? [
      make("p", `${one.camera}, track ${one.track}, frames ${one.first} to ${one.last}: ${one.person || "nobody"}${one.reason ? ` (${one.reason})` : ""}`),
      make("div", "", { className: "row" },
        ...people().filter((p) => p !== one.person).map((p) => button(`This is ${p}`, () => rename(p), also(p))),
        ...(one.person ? people().filter((p) => p !== one.person).flatMap((p) => [0, frame].slice(0, frame ? 2 : 1).map((from) =>
          button(`Swap ${one.person} and ${p} in ${one.camera}${from ? ` from frame ${from} on` : ""}`, () => swap(p, from)))) : []),
        one.person && button("Not a person", () => rename("")), button("A new person", () => rename(fresh())),
        one.first < frame && frame <= one.last && button(`Split at frame ${frame}`, () => split()))]
      : [make("p", "Click a person in a picture, or a bar below.", { className: "soft" })]));
  }
  function draw() {
    views.forEach(boxes);
    tell();
    const bar = (k) => {
      const { first, last, camera, track } = tracks[k], made = button(camera, () => { chosen = k; draw(); if (frame < first || frame > last) seek(first); },
        { title: `${camera}, track ${track}, frames ${first} to ${last}` });
      made.style.cssText = `left:${(100 * first) / frames}%;width:${(100 * (last + 1 - first)) / frames}%;--c:${colour(tracks[k].person)}`;
      made.setAttribute("aria-pressed", k === chosen);
      return made;
    };
    lines.replaceChildren(...[...people(), ""].map((person) => {
      const mine = tracks.map((_, k) => k).filter((k) => tracks[k].person === person), shown = cameras.map(({ name: camera }) =>
        make("div", "", { className: "lane" }, ...mine.filter((k) => tracks[k].camera === camera).map(bar)));
      return make("div", "", { className: "person", style: `--c:${colour(person)}` }, make("b", person || "nobody"), make("div", "", { className: "lanes" }, ...shown));
    }).filter((row, k) => k < people().length || tracks.some((one) => !one.person)));
    undo.disabled = save.disabled = !past.length;
    if (past.length) lines.dataset.unsaved = 1; else delete lines.dataset.unsaved;
    jobs.replaceChildren();
  }

  const undo = button("Undo", () => { tracks = past.pop() || tracks; chosen = Math.min(chosen, tracks.length - 1); draw(); }, { id: "undo" });
  const save = button("Save", tried(async () => {
    say("Saving, and looking which jobs depend on it …", 0);
    const { file, planned } = await post("identities", { name, rows: tracks.map((t) => [t.camera, t.track, t.person]) });
    say(`Saved in ${file}`);
    delete lines.dataset.unsaved;
    const count = Object.values(planned).reduce((a, b) => a + b, 0);
    jobs.replaceChildren(make("div", "", { className: "card" },
      make("p", count ? `${count} jobs run again, and what depends on their outcome:` : "Nothing depends on it."),
      make("p", Object.entries(planned).map(([rule, n]) => `${rule.replaceAll("_", " ")}${n > 1 ? ` × ${n}` : ""}`).join(", "), { className: "soft" }),
      count && button("Run them again", tried(async () => { await post("start", { name, goal: "film" }); showProject(name); }), { className: "main", id: "again" })));
  }), { className: "main", id: "save" });

  place.append(make("div", "", { className: cameras.some(({ wh }) => wh[1] > wh[0]) ? "views tall" : "views" }, ...views.map((one) => one.place)),
    make("div", "", { className: "row" }, play, clock), slider, tools, lines,
    make("div", "", { className: "row" }, undo, save,
      make("a", "Pictures of every track", { href: `results/${path(name)}/people/review.html`, target: "_blank" })), jobs);
  draw();
  seek(0);
}
