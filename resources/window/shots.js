// SPDX-License-Identifier: Apache-2.0
// The player in the window: a path of views becomes a shot of the project, and is filmed.

import { button, make, post, say, tried } from "./dom.js";
import { showProject } from "./project.js";

export function showPlayer(place, name, address) {
  const frame = make("iframe", "", { src: address, title: "The scene to fly through", allowFullscreen: true });
  const called = make("input", "", { type: "text", value: "flight", maxLength: 40 }), count = make("span", "no views yet", { className: "soft" });
  called.setAttribute("aria-label", "Name of the film");
  // The same path as in the player's own panel.
  const inside = () => {
    const { player } = frame.contentWindow || {};
    if (!player?.addKey) throw new Error("The player is still opening, or an older one: make the film again");
    return player;
  };
  const show = () => {
    const { length } = inside().keys;
    count.textContent = `${length || "no"} view${length === 1 ? "" : "s"}${length === 1 ? ": add one more" : ""}`;
    inside().changed();
  };
  const add = tried(async () => { inside().addKey(); show(); });
  const drop = tried(async () => { inside().keys.pop(); show(); });
  const film = tried(async () => {
    const player = inside(), shot = called.value.trim();
    if (player.keys.length < 2) throw new Error("Fly to a view and add it, at least twice; the film goes from one to the next");
    const file = await post("shots", { name, shot, text: player.shot(shot) });
    await post("start", { name, goal: "film" });
    say(`The path is saved in ${file}`);
    showProject(name);
  });
  place.append(frame, make("div", "", { className: "row", id: "shots" },
    button("Add this view", add, { id: "add-view" }), button("Remove last", drop), count, called, button("Film this path", film, { className: "main", id: "film-path" })));
}
