// SPDX-License-Identifier: Apache-2.0
// Elements from plain text, requests to the server, and the message at the bottom.

// make("p", "text", { className: "soft" }, child, …): text is never read as HTML.
export function make(tag, text = "", also = {}, ...children) {
  const made = Object.assign(document.createElement(tag), text === "" ? {} : { textContent: text }, also);
  made.append(...children.filter(Boolean));
  return made;
}

export const at = (id) => document.getElementById(id);
export const button = (text, onclick, also = {}) => make("button", text, { type: "button", onclick, ...also });
export const list = (sentences, also = {}) => make("ul", "", also, ...sentences.map((one) => make("li", one)));
export const path = (...parts) => parts.map(encodeURIComponent).join("/");

let hiding = 0;
export function say(text, seconds = 8) {
  Object.assign(at("message"), { textContent: text, hidden: !text });
  clearTimeout(hiding);
  if (seconds) hiding = setTimeout(() => (at("message").hidden = true), 1000 * seconds);
}

const GONE = "The window has ended: start studiorecon open again";

async function answer(sent) {
  const found = await sent.catch(() => { throw new Error(GONE); });
  const held = await found.json().catch(() => ({ error: `the server answered ${found.status}` }));
  if (!found.ok) throw new Error(held.error || `the server answered ${found.status}`);
  return held;
}

export const get = (address) => answer(fetch(`api/${address}`));
export const post = (address, given) => answer(fetch(`api/${address}`, { method: "POST", body: JSON.stringify(given || {}) }));

// A file on its way; unlike fetch, this says how far it is.
export const upload = (address, file, shown) => new Promise((done, fail) => {
  const sent = new XMLHttpRequest();
  sent.open("POST", `api/${address}`);
  sent.responseType = "json";
  sent.upload.onprogress = ({ loaded, total }) => shown(total ? Math.floor((100 * loaded) / total) : 100);
  sent.onload = () => (sent.status === 200 ? done() : fail(new Error(sent.response?.error || `the server answered ${sent.status}`)));
  sent.onerror = () => fail(new Error(GONE));
  sent.send(file);
});

// Runs what a button does; what goes wrong is a sentence at the bottom.
export const tried = (does) => async (...given) => {
  try { return await does(...given); } catch (error) { say(error.message, 15); }
};
