// SPDX-License-Identifier: Apache-2.0
// The page of a project: what was understood, one button, progress, and the film.

import { at, button, get, list, make, path, post, say, tried } from "./dom.js";
import { showPeople } from "./people.js";
import { showPlayer } from "./shots.js";

const GOALS = { film: "Making the film", look: "Making a first look", doctor: "Checking the cameras", takes: "Running the takes" };
const EVERY_MS = 1500;
let asking = 0, tab = "", drawn = "", shown = [];

export const showProject = async (name) => {
  const here = at("main").dataset.name === name;
  if (!here) at("main").replaceChildren(make("h1", name), make("p", "Reading the videos …", { className: "soft" }));
  const about = await get(`project/${path(name)}`), key = JSON.stringify(about);
  watch(name, about.run);
  // What somebody is correcting or writing stays.
  if (here && (key === drawn || document.querySelector("[data-unsaved]"))) return showRun(about.run);
  // A new film is shown when it is there, whatever was open before.
  if (!here) tab = "";
  else if (about.results.films.some((film) => !shown.includes(film))) tab = "Film";
  [drawn, shown] = [key, about.results.films];
  at("main").dataset.name = name;
  const { cameras, calibration } = about;
  const count = `${cameras.length} camera${cameras.length === 1 ? "" : "s"}`;
  const known = cameras.length ? `${count}; calibration: ${calibration || "none"}` : about.is_capture ? "" : "The videos of this scene are elsewhere.";
  at("main").replaceChildren(
    make("h1", name), make("p", known, { className: "soft" }),
    make("div", "", { id: "progress" }), ...results(about), ...footage(about), ...action(about), ...more(about));
  showRun(about.run);
};

function footage({ cameras, name, unused, notes, error, is_capture }) {
  if (!is_capture) return [];
  const add = make("div", "", { className: "row" }, button("Add files", () => at("files").click()),
    make("span", "or drop videos, calibration files or keypoints anywhere", { className: "soft" }));
  const shown = cameras.map(({ name: camera, facts, held_out }) => make("figure", "", {},
    make("img", "", { src: `api/thumbnail/${path(name, camera)}`, alt: `A frame of ${camera}`, loading: "lazy" }),
    make("figcaption", "", {}, make("b", camera), held_out ? " (only for measuring)" : "",
      ...facts.map((fact) => make("div", fact)))));
  return [make("h2", "Videos"), error && make("p", error, { className: "bad" }),
    make("div", "", { className: "grid" }, ...shown), add,
    notes.length && make("details", "", { open: notes.length < 5 }, make("summary", `${notes.length} note${notes.length > 1 ? "s" : ""}`), list(notes)),
    unused.length && make("div", "", { className: "warn" }, make("h2", "Not used"), list(unused)),
  ].filter(Boolean);
}

function action(about) {
  const { name, is_capture, error, cameras, doctor, last, warnings } = about;
  if (!is_capture || (error && !cameras.length)) return [];
  const { choices, chosen } = presetChoices(name, last.preset);
  const start = (goal) => tried(async () => { await post("start", { name, goal, preset: chosen() }); showProject(name); });
  const begun = last.unfinished && !about.run && !/ snakemake doctor /.test(last.command);
  return [make("div", "", { className: "card", id: "action" }, make("h2", "Make the film"), choices,
    make("div", "", { className: "row" },
      button(begun ? "Go on" : "Make the film", start("film"), { className: "main", id: "make" }),
      button("Check the cameras first", start("doctor"), { id: "check" }))),
  doctor.verdict && make("div", "", { className: "card" }, make("h2", `The cameras are ${doctor.verdict}`), list(doctor.sentences)),
  last.why.length && !about.run && make("div", "", { className: "card" }, make("h2", "The last run failed"), list(last.why, { className: "bad" })),
  last.log.length && !about.run && make("details", "", {}, make("summary", "What the last run said"), make("pre", last.log.join("\n"))),
  warnings.length && make("details", "", {}, make("summary", `${warnings.length} warning${warnings.length > 1 ? "s" : ""}`), list(warnings, { className: "warn" })),
  ].filter(Boolean);
}

// The presets with their times for a project, and which of them is chosen.
export function presetChoices(name, first) {
  const choices = make("div", "", { className: "choices" }, make("p", "Estimating the times …", { className: "soft" }));
  get(`presets/${path(name)}`).then((offers) => choices.replaceChildren(...offers.map(({ preset, name: called, about: text, seconds, low_s, high_s }) =>
    make("label", "", {}, make("input", "", { type: "radio", name: "preset", value: preset, checked: preset === first }),
      make("b", called), make("span", `${time(low_s)} to ${time(high_s)}, likely ${time(seconds)}`), make("span", text)))))
    .catch((failed) => choices.replaceChildren(make("p", failed.message, { className: "soft" })));
  return { choices, chosen: () => choices.querySelector(":checked")?.value || "" };
}

const time = (s) => (s < 90 ? `${Math.round(s)} s` : s < 5400 ? `${Math.round(s / 60)} min` : `${(s / 3600).toFixed(1)} h`);

function more({ name, is_capture, capture_yaml, settings, last }) {
  if (!is_capture) return [];
  const text = make("textarea", "", { value: capture_yaml, spellcheck: false, oninput: () => (text.dataset.unsaved = 1) });
  text.setAttribute("aria-label", "capture.yaml");
  const save = tried(async () => { await post("capture", { name, text: text.value }); say("capture.yaml is saved"); delete text.dataset.unsaved; drawn = ""; showProject(name); });
  return [make("details", "", {}, make("summary", "capture.yaml: frames, time offsets, held-out cameras, heights"), text,
    make("div", "", { className: "row" }, button("Save capture.yaml", save))),
  (last.command || settings) && make("details", "", {}, make("summary", "In a terminal"), last.command && make("pre", last.command.replace(/^\$ /, "")),
    settings && make("p", `Its own settings are in ${settings}.`))].filter(Boolean);
}

function results({ name, results: made }) {
  const views = {};
  if (made.films.length) views.Film = (place) => place.append(...made.films.map((film, k) =>
    make("figure", "", {}, make("video", "", { src: film, controls: true, loop: true, muted: true, autoplay: !k, playsInline: true }),
      make("figcaption", film))));
  if (made.player) views.Fly = (place) => showPlayer(place, name, made.player);
  if (made.review) views.People = (place) => showPeople(place, name);
  if (made.page) views.Page = (place) => place.append(make("iframe", "", { src: made.page, title: "The scene's page" }));
  if (made.doctor) views.Cameras = (place) => place.append(make("iframe", "", { src: made.doctor, title: "The doctor's page" }));
  const names = Object.keys(views);
  if (!names.length) return [];
  if (!names.includes(tab)) [tab] = names[0] === "Film" ? names : [""];
  const place = make("div"), tabs = make("div", "", { className: "tabs", role: "tablist" });
  const show = tried(async (chosen) => {
    tab = chosen;
    for (const one of tabs.children) one.setAttribute("aria-selected", one.textContent === tab);
    place.replaceChildren();
    if (tab) await views[tab](place);
  });
  tabs.append(...names.map((one) => button(one, () => show(one), { role: "tab" })));
  show(tab);
  return [tabs, place];
}

export function showRun(run, snapshot = 0) {
  const place = at("progress"), page = at("main").dataset.name, mine = run && (run.scene === page || (run.goal === "takes" && page === "/takes"));
  if (!place) return;
  for (const id of ["make", "check"]) if (at(id)) at(id).disabled = Boolean(at(id).dataset.short) || Boolean(run) && !(id === "make" && run.ours && run.goal === "doctor");
  if (!run) return place.replaceChildren();
  if (!mine) return place.replaceChildren(make("p", `A run of ${run.scene || "takes"} is on. One run at a time: wait for its end.`, { className: "card" }));
  const share = run.total ? run.done / run.total : 0, bar = make("div", "", { className: "bar", role: "progressbar" }, make("i"));
  bar.firstChild.style.width = `${Math.max(2, 100 * share)}%`;
  bar.setAttribute("aria-valuenow", Math.round(100 * share));
  const stop = tried(async () => { say("Stopping …", 0); await post("stop"); say("Stopped. What is finished is kept."); dispatchEvent(new HashChangeEvent("hashchange")); });
  const picture = snapshot && make("figure", "", { style: "max-width:520px;margin-top:12px" },
    make("img", "", { src: `api/snapshot/${path(run.scene)}?${snapshot}`, alt: "The room as it is now" }), make("figcaption", "The room as it trains"));
  place.replaceChildren(make("div", "", { className: "card" }, make("h2", `${GOALS[run.goal] || "A run is on"}${run.goal === "takes" && run.scene ? `: ${run.scene}` : ""}`),
    make("p", run.total ? `${run.done} of ${run.total} jobs, ${run.left}` : "Starting …"), bar,
    run.running?.length && make("p", run.running.join("; "), { className: "soft" }), picture,
    run.ours ? button("Stop", stop) : make("p", "It was started in a terminal, and stops there with Ctrl-C.", { className: "soft" })));
}

// Asks for the run's state while one is on and the page is seen.
export function watch(name, run) {
  clearTimeout(asking);
  if (!run || document.hidden) return;
  const known = JSON.stringify([run.scene, run.goal, run.pid]);
  asking = setTimeout(tried(async () => {
    if (at("main").dataset.name !== name) return;
    const { run: now, snapshot } = await get("run");
    if (!now || JSON.stringify([now.scene, now.goal, now.pid]) !== known) return dispatchEvent(new HashChangeEvent("hashchange"));
    showRun(now, snapshot);
    watch(name, now);
  }), EVERY_MS);
}
