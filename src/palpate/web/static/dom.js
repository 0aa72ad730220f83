// Small helpers: finding elements, making them, changing them only when they differ.

export const find = (id) => document.getElementById(id);

export function make(tag, properties = {}, ...children) {
  const element = document.createElement(tag);
  for (const [name, value] of Object.entries(properties)) {
    if (name.startsWith("on")) element.addEventListener(name.slice(2), value);
    else if (name === "class") element.className = value;
    else if (name in element) element[name] = value;
    else element.setAttribute(name, value);
  }
  element.append(...children);
  return element;
}

// An element of a drawing.
export function drawn(tag, place, words = "") {
  const element = document.createElementNS("http://www.w3.org/2000/svg", tag);
  for (const [name, value] of Object.entries(place)) element.setAttribute(name, value);
  text(element, words);
  return element;
}

export function text(element, words) {
  const whole = unbroken(words);
  if (element.textContent !== whole) element.textContent = whole;
}

// With a space between a number and its % at which no line breaks.
export const unbroken = (words) => words.replace(/(\d) %/g, "$1\u00a0%");

export function show(element, whether) {
  if (element.hidden === whether) element.hidden = !whether;
}

// A row of pictures; those that stay are not loaded again. With `open` each is a button.
// Without a source there is a cross: nothing was met.
export function pictures(list, items) {
  const old = new Map([...list.children].map((item) => [item.dataset.key, item]));
  list.replaceChildren(...items.map(({ key, label, alt, src, open }) => {
    const kept = old.get(String(key));
    if (kept) {
      text(kept.lastChild, label);
      return kept;
    }
    const picture = src ? make("img", { class: "thumb", alt, src }) : make("span", { class: "thumb missed", role: "img", "aria-label": alt }, "×");
    return make("li", { "data-key": key }, pressable(picture, src && open), label);
  }));
}

// A picture that can be pressed, to look at it.
export function pressable(picture, open) {
  return open ? make("button", { type: "button", class: "look", onclick: open }, picture) : picture;
}

// Ask before something is done; true for yes.
export async function asked(dialog) {
  dialog.returnValue = "";
  dialog.showModal();
  await new Promise((resolve) => dialog.addEventListener("close", resolve, { once: true }));
  return dialog.returnValue === "ok";
}

export const confirmed = async (...words) => await chosen(...words) === "ok";

// As `confirmed`, perhaps with something better to do `first`: "ok", "first", or "" for no.
export async function chosen(title, words, yes, no, first = "") {
  text(find("confirm-title"), title);
  text(find("confirm-text"), words);
  text(find("confirm-ok"), yes);
  text(find("confirm-no"), no);
  text(find("confirm-first"), first);
  show(find("confirm-first"), first !== "");
  const done = await asked(find("confirm"));
  return done ? "ok" : find("confirm").returnValue === "first" ? "first" : "";
}

// What one of the three steps is like, and whether it is done.
export function step(number, words, done) {
  const item = find(`step-${number}`);
  text(item.querySelector("span"), words);
  item.classList.toggle("done", done);
}

// Rounded down, so that shares never sum to more than 100 %, and what has not reached a
// limit never reads as if it had. Reports round as this does (`figure_of`).
export const percent = (share) => {
  if (share > 0.999 && share < 1) return unbroken(">99.9 %");
  if (share < 0.001 && share > 0) return unbroken("<0.1 %");
  const steps = share >= 0.1 && share < 0.99 ? 1 : 10;
  return unbroken(`${(Math.floor(100 * steps * share + 1e-9) / steps).toFixed(share > 0 && share < 1 && steps > 1 ? 1 : 0)} %`);
};

// What is decided, in few words; nothing where nothing is.
export function decided({ decision, category, in_doubt: doubted }) {
  const name = decision === "unknown" ? "nothing I know" : decision ?? (category && `${/^[aeiou]/i.test(category) ? "an" : "a"} ${category}`);
  return name && doubted ? `${name}, in doubt` : name;
}

let hiding = 0;

// What was done or refused, for a while; in the dialog that is open, which covers the rest.
export function say(words) {
  const status = find("status");
  const place = document.querySelector("dialog[open]") ?? find("bar-top");
  if (status.parentElement !== place) place.append(status);
  text(status, words);
  status.classList.toggle("shown", words !== "");
  clearTimeout(hiding);
  hiding = setTimeout(() => {
    status.classList.remove("shown");
    text(status, "");
  }, 6000);
}
