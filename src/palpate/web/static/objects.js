// Objects of the library: their touches, renaming, forgetting, export.

import { get, post, url } from "./api.js";
import { find, make, percent, show, text } from "./dom.js";

const THUMBNAILS = 8;
const cards = new Map();
let wanted = null;

export function showObjects({ library, model, quality }) {
  const objects = library ? library.objects : [];
  const learnt = new Set(model ? model.objects : []);
  const names = new Set(objects.map((one) => one.name));
  const alone = [...learnt].filter((name) => !names.has(name))
    .map((name) => ({ name, n_touches: 0 }));
  const all = [...objects, ...alone];
  show(find("none"), all.length === 0);
  show(find("left-out"), quality.length > 0);
  const known = new Map(quality.map((one) => [one.name, one]));
  for (const [name, card] of cards) {
    if (all.some((one) => one.name === name)) continue;
    card.remove();
    cards.delete(name);
  }
  all.forEach((one, at) => {
    if (!cards.has(one.name)) cards.set(one.name, makeCard(one.name, library !== null));
    const card = cards.get(one.name);
    if (find("list").children[at] !== card) find("list").insertBefore(card, find("list").children[at] ?? null);
    update(card, one, learnt.has(one.name), names.has(one.name));
    text(card.querySelector(".quality"), worded(known.get(one.name)));
  });
  if (cards.has(wanted)) focusOn(wanted);
}

function makeCard(name, manage) {
  const about = { "aria-label": `Rename ${name}`, type: "button", onclick: () => rename(name) };
  const leave = { "aria-label": `Forget ${name}`, type: "button", onclick: () => forget(name) };
  const link = { class: "button", download: "", "aria-label": `Export ${name}`,
    href: url(`objects/archive?object=${encodeURIComponent(name)}`) };
  return make("li", { class: "object" },
    make("h3", {}, name), make("p", { class: "meta" }), make("div", { class: "thumbs" }), make("p", { class: "quality" }),
    ...(manage ? [make("div", { class: "row" }, make("button", about, "Rename"),
      make("button", leave, "Forget"), make("a", link, "Export"))] : []));
}

function update(card, { name, n_touches: count }, learnt, stored) {
  const state = learnt ? "learnt" : count > 1 ? "not learnt yet" : "too few to learn";
  const [, meta, thumbs] = card.children;
  const touches = stored ? `${count} touch${count === 1 ? "" : "es"}, ` : "in the model alone, so it cannot be renamed, ";
  text(meta, touches + state);
  const [renaming, , exporting] = card.querySelectorAll(".row > *");
  if (renaming) {
    renaming.disabled = !stored;
    renaming.title = stored ? "" : "Only the model knows it: teach it here to rename it.";
  }
  if (exporting) show(exporting, stored);
  if (stored && card.dataset.count !== String(count)) {
    card.dataset.count = String(count);
    showThumbs(thumbs, name);
  }
}

function worded(quality) {
  if (!quality || quality.after_one === null) return "";
  const { n_touches: n, after_one: one, after_eight: eight, taken_for: other } = quality;
  return `Asked again: ${Math.round(n * one)} of ${n} touches right` + (eight === null ? "" : `, after eight touches ${percent(eight)}`) +
    (other ? `; else mostly taken for ${other}.` : ".");
}

async function showThumbs(place, name) {
  const ids = await get(`objects/touches?object=${encodeURIComponent(name)}&limit=${THUMBNAILS}`);
  if (!ids) return;
  place.replaceChildren(...ids.map(({ id }) => make("img", {
    class: "thumb", alt: `A touch of ${name}`, loading: "lazy", src: url(`touches/${id}/picture`) })));
}

async function asked(dialog) {
  dialog.returnValue = "";
  dialog.showModal();
  await new Promise((resolve) => dialog.addEventListener("close", resolve, { once: true }));
  return dialog.returnValue === "ok";
}

async function rename(name) {
  const field = find("new-name");
  const merging = () => field.value.trim() !== name && cards.has(field.value.trim());
  const show = () => {
    text(find("rename-note"), merging() ? `There is ${field.value.trim()} already: the touches of both become one object.` : "");
    text(find("rename-ok"), merging() ? "Make them one" : "Rename");
  };
  text(find("rename-title"), `Rename ${name}`);
  field.value = name;
  field.oninput = show;
  show();
  if (!await asked(find("rename"))) return;
  const order = { object: name, name: field.value, merge: merging() };
  if (await post("objects/rename", order)) focusOn(field.value.trim());
}

async function forget(name) {
  text(find("forget-title"), `Forget ${name}?`);
  text(find("forget-text"), `Its touches are left out from now on, and ${name} is no longer recognised.`);
  if (await asked(find("forget")) && await post("objects/forget", { object: name })) focusOn(null);
}

// A card that is gone takes the focus with it: it goes to the one that came, or the list.
function focusOn(name) {
  wanted = name === null || cards.has(name) ? null : name;
  (cards.get(name)?.querySelector("button") ?? find("objects-title")).focus();
}
