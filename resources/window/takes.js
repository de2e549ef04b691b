// SPDX-License-Identifier: Apache-2.0
// Takes of one rig: chosen here, run one after another on the same cameras, with a table at the end.

import { at, button, get, make, path, post, say, tried } from "./dom.js";
import { presetChoices, showRun, watch } from "./project.js";

export const TAKES = "/takes";

export async function showTakes(projects) {
  const { run, rows } = await get("takes"), captures = projects.filter((one) => one.is_capture);
  const boxes = captures.map(({ name }) => make("input", "", { type: "checkbox", value: name, onchange: count }));
  const times = make("div");
  let first = "", chosen = () => "";
  const go = button("Run these takes", tried(async () => {
    await post("takes", { names: picked(), preset: chosen() });
    say("The first take has the best cameras; the others use them.");
    showTakes(projects);
  }), { className: "main", id: "make" });
  const picked = () => boxes.filter((one) => one.checked).map((one) => one.value);
  function count() {
    const [name = ""] = picked();
    if (name && name !== first) {
      const offered = presetChoices(name, chosen());
      ({ chosen } = offered);
      times.replaceChildren(make("p", `Times are for ${name} alone. Settings files of single takes are not read.`, { className: "soft" }), offered.choices);
      first = name;
    }
    go.dataset.short = picked().length < 2 ? "1" : "";
    showRun(run);
  }
  const state = ({ result }) => (run ? { "not run": "waits" } : { running: "broken off" })[result] || result;
  const table = make("table", "", {},
    make("tr", "", {}, ...["take", "", "people", "frames", "minutes", "warnings"].map((head) => make("th", head))),
    ...rows.flatMap((row) => [make("tr", "", {},
      make("td", "", {}, make("a", row.take, { href: `#${path(row.take)}` })),
      make("td", state(row), { className: { done: "good", failed: "bad" }[row.result] || "" }),
      ...["people", "frames", "minutes", "warnings"].map((of) => make("td", row[of]))),
    row.notes && make("tr", "", {}, make("td", row.notes, { colSpan: 6, className: "soft" }))].filter(Boolean)));
  at("main").dataset.name = TAKES;
  at("main").replaceChildren(make("h1", "Takes of one rig"),
    make("p", "The cameras stood still between these takes. They are found once, and the takes run one after another.", { className: "soft" }),
    make("div", "", { id: "progress" }), rows.length && make("div", "", { className: "wide" }, table),
    make("div", "", { className: "card", id: "action" }, make("h2", "Takes to run"),
      ...captures.map(({ name }, k) => make("label", "", { className: "take" }, boxes[k], make("span", name))),
      times,
      make("div", "", { className: "row" }, go)));
  count();
  watch(TAKES, run);
}
