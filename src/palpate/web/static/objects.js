// Objects of the library: their touches, renaming, forgetting, export.

import { get, post, url } from "./api.js";
import { asked, confirmed, find, make, percent, pressable, show, text } from "./dom.js";
import { openStored } from "./editor.js";

const THUMBNAILS = 8;
const PAGE = 100;
const FEW = 6; // objects that need no filter
const cards = new Map();
let wanted = null;
let newest = null;

export function startObjects() {
  find("filter").addEventListener("input", () => showObjects(newest));
  find("order").addEventListener("change", () => showObjects(newest));
}

// What happened to their touches is not known.
export const doubtObjects = () => cards.forEach((card) => { delete card.dataset.count; });

export function showObjects(state) {
  newest = state;
  const { library, model, quality } = state;
  const objects = library ? library.objects : [];
  const learnt = new Set(model ? model.objects : []);
  const names = new Set(objects.map((one) => one.name));
  const before = model?.n_elsewhere ?? {};
  const alone = [...learnt].filter((name) => !names.has(name))
    .map((name) => ({ name, n_touches: 0 }));
  const known = new Map(quality.map((one) => [one.name, one]));
  const all = ordered([...objects, ...alone], known);
  show(find("objects"), library !== null || all.length > 0);
  show(find("none"), all.length === 0);
  show(find("left-out"), quality.length > 0);
  for (const [name, card] of cards) {
    if (all.some((one) => one.name === name)) continue;
    card.remove();
    cards.delete(name);
  }
  all.forEach((one, at) => {
    if (!cards.has(one.name)) cards.set(one.name, makeCard(one.name, library !== null));
    const card = cards.get(one.name);
    const still = card.contains(document.activeElement); // a card that is moved loses the focus
    if (find("list").children[at] !== card && !still) find("list").insertBefore(card, find("list").children[at] ?? null);
    update(card, { ...one, before: before[one.name] ?? 0 }, learnt.has(one.name), names.has(one.name), (library?.changed ?? []).includes(one.name));
    text(card.querySelector(".quality"), worded(known.get(one.name)));
    mark(card);
  });
  sift(all);
  if (cards.has(wanted)) focusOn(wanted);
}

// Those that are taken for others most often first, or by name.
function ordered(all, known) {
  const right = (one) => known.get(one.name)?.after_one ?? 2;
  const confused = find("order").value === "confused" && known.size > 0;
  return all.sort((a, b) => (confused && right(a) - right(b)) || a.name.localeCompare(b.name));
}

function sift(all) {
  show(find("sift"), all.length > FEW);
  const words = all.length > FEW ? find("filter").value.trim().toLowerCase() : "";
  const shown = all.filter(({ name }) => name.toLowerCase().includes(words));
  const names = new Set(shown.map(({ name }) => name));
  for (const [name, card] of cards) show(card, names.has(name));
  text(find("sifted"), `${shown.length} of ${all.length} objects`);
}

function makeCard(name, manage) {
  const about = { "aria-label": `Rename ${name}`, type: "button", onclick: () => rename(name) };
  const leave = { "aria-label": `Forget ${name}`, type: "button", onclick: () => forget(name) };
  const link = { class: "button", download: "", "aria-label": `Export ${name}`,
    href: url(`objects/archive?object=${encodeURIComponent(name)}`) };
  return make("li", { class: "object" },
    make("h3", { tabIndex: -1 }, name), make("p", { class: "meta" }), make("div", { class: "thumbs" }), make("p", { class: "quality" }), make("p", { class: "silent-note" }),
    ...(manage ? [make("div", { class: "row" }, make("button", about, "Rename"),
      make("button", leave, "Forget"), make("a", link, "Export"))] : []));
}

function update(card, { name, n_touches: count, before }, learnt, stored, changed) {
  const state = !learnt ? count > 1 ? "not learnt yet" : "too few to learn"
    : changed ? "changed since it was learnt: learn again" : "learnt";
  const [, meta, thumbs] = card.children;
  const counted = (number) => `${number} touch${number === 1 ? "" : "es"}`;
  text(meta, stored ? `${counted(count)}${before ? ` here and ${before} from elsewhere` : ""}, ${state}`
    : `${counted(before)} from elsewhere, ${state}; in the model alone, so it cannot be renamed`);
  show(thumbs, stored);
  const [renaming, , exporting] = card.querySelectorAll(".row > *");
  if (renaming) {
    renaming.disabled = !stored;
    renaming.title = stored ? "" : "Only the model knows it: teach it here to rename it.";
  }
  if (exporting) show(exporting, stored);
  if (stored && card.dataset.count !== String(count)) {
    card.dataset.count = String(count);
    showThumbs(card, thumbs, name, count);
  }
}

// Touches without contact, which do not count: named, so that they can be removed.
function mark(card) {
  let n = 0;
  for (const button of card.querySelectorAll(".thumbs .look")) {
    const silent = (newest?.no_contact ?? []).includes(button.dataset.key);
    button.classList.toggle("silent", silent);
    button.title = silent ? "This touch shows no contact and does not count." : "";
    n += silent;
  }
  text(card.querySelector(".silent-note"), n ? `${n} touch${n === 1 ? "" : "es"} (dashed) without contact, not counted: press to remove.` : "");
}

function worded(quality) {
  if (!quality || quality.after_one === null) return "";
  const { n_touches: n, after_one: one, after_eight: eight, taken_for: other } = quality;
  return `Asked again: ${Math.round(n * one)} of ${n} touches right` + (eight === null ? "" : `, after eight touches ${percent(eight)}`) +
    (other ? `; else mostly taken for ${other}.` : ".");
}

// The newest touches; all of them, page by page, once they were asked for.
async function showThumbs(card, place, name, count) {
  const most = Math.max(THUMBNAILS, Number(card.dataset.most ?? 0));
  const ids = [];
  for (let from = 0; from < Math.min(most, count); from += PAGE) {
    const limit = Math.min(PAGE, most - from);
    const part = await get(`objects/touches?object=${encodeURIComponent(name)}&limit=${limit}&offset=${from}`);
    if (!part) return;
    ids.push(...part);
  }
  if (card.dataset.count !== String(count)) return; // it changed meanwhile
  const old = new Map([...place.children].map((item) => [item.dataset.key, item]));
  const focused = place.contains(document.activeElement);
  place.replaceChildren(...ids.map(({ id }) => old.get(id) ?? thumb(id, name, card)));
  place.classList.toggle("all", most > THUMBNAILS);
  mark(card);
  if (focused && document.activeElement === document.body) card.querySelector("h3").focus();
  const more = count - ids.length;
  if (more > 0) place.append(make("button", { type: "button", class: "more", "aria-label": `Show ${Math.min(more, PAGE)} more touches of ${name}`,
    onclick: async () => {
      card.dataset.most = String(most > THUMBNAILS ? most + PAGE : PAGE);
      await showThumbs(card, place, name, count);
      (place.children[ids.length] ?? card.querySelector("h3")).focus();
    } }, `+${more}`));
}

function thumb(id, name, card) {
  const picture = make("img", { class: "thumb", alt: `A touch of ${name}`, loading: "lazy", src: url(`touches/${id}/picture`) });
  const button = pressable(picture, () => openStored(id, name, card.querySelector("h3")));
  button.dataset.key = id;
  return button;
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
  const words = `Its touches are left out from now on, and ${name} is no longer recognised. Undo, under Teach, brings back those that are stored here.`;
  if (await confirmed(`Forget ${name}?`, words, "Forget", "Keep") && await post("objects/forget", { object: name })) focusOn(null);
}

// A card that is gone takes the focus with it: it goes to the one that came, or the list.
function focusOn(name) {
  wanted = name === null || cards.has(name) ? null : name;
  (cards.get(name)?.querySelector(".row button") ?? find("objects-title")).focus();
}
