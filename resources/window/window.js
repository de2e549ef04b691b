// SPDX-License-Identifier: Apache-2.0
// The window: projects at the side, drops, and the page of a project. It asks the server again while a run is on and
// when somebody comes back to it, and never otherwise.

import { at, button, get, make, path, post, say, tried, upload } from "./dom.js";
import { showProject } from "./project.js";
import { TAKES, showTakes } from "./takes.js";

export const current = () => decodeURIComponent(location.hash.slice(1));

async function showSide() {
  const { folder, projects } = await get("projects");
  at("folder").textContent = `Projects and results are in ${folder}`;
  at("projects").replaceChildren(...projects.map(({ name, made }) => {
    const link = make("a", name, { href: `#${encodeURIComponent(name)}` }, made && make("small", "film"));
    if (name === current()) link.setAttribute("aria-current", "page");
    return link;
  }));
  at("takes").hidden = projects.filter((one) => one.is_capture).length < 2;
  return projects;
}

export const open = tried(async () => {
  const projects = await showSide(), name = current();
  document.title = name ? `${name} · studiorecon` : "studiorecon";
  if (name === TAKES && !at("takes").hidden) await showTakes(projects);
  else if (name && projects.some((one) => one.name === name)) await showProject(name);
  else showStart(projects.length);
});

function showStart(others) {
  delete at("main").dataset.name;
  const folder = make("input", "", { type: "text", placeholder: "/home/me/takes/monday" });
  folder.setAttribute("aria-label", "Folder on this machine");
  const real = tried(async () => {
    say("Fetching four films, 51 MB …", 0);
    const name = await post("real");
    say("");
    location.hash = encodeURIComponent(name);
  });
  const link = tried(async () => { location.hash = encodeURIComponent(await post("link", { folder: folder.value.trim() })); });
  at("main").replaceChildren(
    make("h1", others ? "New project" : "From a few videos to a scene you can fly through"),
    make("p", "Two or more cameras on tripods film the same moment. Their videos are enough; a calibration helps.", { className: "soft" }),
    make("div", "", { className: "drop" },
      make("p", "Drop the videos of one take here, with calibration files if you have some"),
      make("div", "", { className: "row", style: "justify-content:center" },
        button("Choose videos", () => at("files").click(), { className: "main" }),
        button("Choose a folder", () => at("whole").click()))),
    make("div", "", { className: "card" },
      make("p", "Or use a folder of this machine where it is. Nothing is copied."),
      make("form", "", { className: "row", onsubmit: (event) => { event.preventDefault(); link(); } },
        folder, make("button", "Use this folder"))),
    make("div", "", { className: "card" },
      make("p", "Or try a real take: one man on a treadmill, four cameras, from the package Pose2Sim (BSD 3-Clause, 51 MB)."),
      make("div", "", { className: "row" }, button("Fetch it", real, { id: "real" }))));
}

// [{ file, path }] of what was dropped, folders included.
async function dropped(items) {
  const found = [], entries = [...items].map((item) => item.webkitGetAsEntry && item.webkitGetAsEntry()).filter(Boolean);
  async function walk(entry, before) {
    const name = before ? `${before}/${entry.name}` : entry.name;
    if (entry.isFile) found.push({ file: await new Promise((done, fail) => entry.file(done, fail)), path: name });
    else for (const reader = entry.createReader(); ;) {
      const some = await new Promise((done, fail) => reader.readEntries(done, fail));
      if (!some.length) break;
      for (const one of some) await walk(one, name);
    }
  }
  for (const entry of entries) await walk(entry, "");
  return found;
}

// Copies files into the open project, or into a new one that is named after their folder, or after today.
export const take = tried(async (files) => {
  files = files.filter((one) => !one.path.split("/").some((part) => part.startsWith(".")));
  if (!files.length) return say("There is no file in what was dropped.");
  const first = files[0].path.split("/"), whole = files.every((one) => one.path.startsWith(`${first[0]}/`));
  let name = current();
  if (!name || name === TAKES) {
    name = "";
    const { projects } = await get("projects"), day = new Date().toISOString().slice(0, 10);
    const wanted = whole ? first[0].replace(/[^\p{L}\p{N} ._+@()-]/gu, "_").trim() : `take-${day}`;
    for (let k = 1; !name || projects.some((one) => one.name === name); k++) name = k > 1 ? `${wanted}-${k}` : wanted;
    await post("new", { name });
  }
  const failed = [], fresh = current() !== name;
  for (const [k, one] of files.entries()) {
    const shown = (percent) => say(`Copying ${k + 1} of ${files.length}: ${one.path}, ${percent} %`, 0);
    const place = fresh && whole ? one.path.split("/").slice(1).join("/") : one.path;
    try { await upload(`upload/${path(name)}?path=${encodeURIComponent(place)}`, one.file, shown); } catch (error) { failed.push(error.message); }
  }
  say(failed.length ? failed.slice(0, 3).join(". ") : `${files.length} files copied`, failed.length ? 20 : 4);
  location.hash = encodeURIComponent(name);
  if (fresh && !failed.length) await post("start", { name, goal: "doctor" }).catch(() => {});
  await open();
});

for (const [id, of] of [["files", "name"], ["whole", "webkitRelativePath"]])
  at(id).onchange = () => {
    take([...at(id).files].map((file) => ({ file, path: file[of] })));
    at(id).value = "";
  };
at("takes").onclick = () => (location.hash = TAKES);
at("new").onclick = () => (location.hash = "");
let inside = 0;
addEventListener("dragenter", () => (at("dropping").hidden = !++inside));
addEventListener("dragleave", () => (at("dropping").hidden = !--inside));
addEventListener("dragover", (event) => event.preventDefault());
addEventListener("drop", async (event) => {
  event.preventDefault();
  at("dropping").hidden = !(inside = 0);
  take(await dropped(event.dataTransfer.items));
});
addEventListener("hashchange", open);
addEventListener("beforeunload", (event) => document.querySelector("[data-unsaved]") && event.preventDefault());
addEventListener("visibilitychange", () => document.hidden || open());
open();
