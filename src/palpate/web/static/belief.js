// The belief: a bar for each object and one for none, its history, the decision.

import { showAbove } from "./above.js";
import { get, post, url } from "./api.js";
import { decided, drawn, find, make, percent, pictures, pressable, show, step, text, unbroken } from "./dom.js";
import { openPicture, openStored } from "./editor.js";
import { marked } from "./marks.js";
import { keepOf, teachThese } from "./teach.js";

const SHOWN = 6;
const OTHERS = "var(--c7)";
const WINDOW = 12;
const RESTED_MS = 20000;
const ROOM = 0.25; // share of a column that has room for letters

let episode = null;
let marks = new Map();
let resting = 0;
let alarmed = false;
let alarmText = "";

export function startBelief() {
  find("fresh").addEventListener("click", () => {
    teachThese(0);
    post("episode/start");
  });
  find("teach-this").addEventListener("click", () => teachThese(pictured()));
  find("wrong").addEventListener("submit", (event) => {
    event.preventDefault();
    teachThese(pictured(), find("right-name").value);
    find("right-name").value = "";
  });
}

export const currentEpisode = () => episode;

// How many touches can be taught: where nothing was met there is no picture.
const pictured = () => episode.touches.filter(({ miss }) => !miss).length;

// Where touches look as if they were of another sensor, a doubt stands beside what is
// decided: on another day things that are known are called unknown.
export function showEpisode(whole, alarm = "") {
  const goesOn = episode?.number === whole.number && whole.touches.length >= episode.touches.length;
  episode = whole;
  keepOf(goesOn ? pictured() : 0);
  alarmText = alarm;
  alarmed = alarm !== "" && whole.touches.length > 0;
  draw();
}

export async function addTouch(news) {
  const [touch] = news.touches;
  const held = episode?.number === news.number ? episode.touches : [];
  if (touch.number <= held.length) return;
  const inOrder = touch.number === held.length + 1;
  const whole = inOrder ? { ...news, touches: [...held, touch] } : (await get("episode")) ?? news;
  if (isOlder(whole)) return;
  showEpisode(whole, alarmText);
}

// Whether there were newer touches while an episode was asked for.
function isOlder({ number, touches }) {
  if (!episode || number !== episode.number) return number < episode?.number;
  return touches.length < episode.touches.length;
}

export function showNearest(nearest) {
  show(find("near"), nearest.length > 0);
  find("nearest").replaceChildren(...nearest.map(({ id, object, distance }) => {
    const words = `${object}, distance ${distance.toFixed(2)}`;
    const picture = id === null ? [] : [pressable(make("img", {
      class: "thumb", alt: words, loading: "lazy", src: url(`touches/${id}/picture`) }), () => openStored(id, object, find("belief")))];
    return make("li", { title: words }, ...picture, object);
  }));
}

function draw() {
  const { touches } = episode;
  const last = touches.at(-1);
  const n = touches.length;
  const { n_counted: counted } = episode;
  const said = counted < n ? `${counted} of ${n} touches count` : `${n} touch${n === 1 ? "" : "es"}`;
  marks = marked(Object.keys(last?.posterior ?? {}));
  show(find("rested"), false);
  clearTimeout(resting);
  if (n && episode.open) resting = setTimeout(() => show(find("rested"), true), RESTED_MS);
  const unknown = episode.decision === "unknown";
  const teachable = n > 0 && !find("teaching").hidden && !find("lesson").hidden;
  show(find("stranger"), unknown && teachable);
  show(find("wrong"), !unknown && teachable && Boolean(decided(episode)));
  const learnt = document.body.dataset.asks === "true";
  const doubted = episode.in_doubt ? ", in doubt" : "";
  step(3, !learnt ? "" : episode.decision ? episode.decision + doubted : n ? said : "ready", episode.decision !== null && !doubted);
  text(find("count"), n === 0 ? "no touch yet" : `${said}${episode.open ? "" : ", ended"}`);
  drawDecision(n);
  drawBars(last?.posterior ?? {});
  drawUnknown(last);
  drawHistory();
  showAbove(episode);
}

// The heading says what is decided and nothing else. What it may be says the sentence,
// which is the library's: the terminal, reports and Python show the same.
function drawDecision(n) {
  const place = find("decision");
  const { decision, in_doubt: doubted, sentence, why, withdrawn } = episode;
  const learnt = document.body.dataset.asks === "true";
  const named = decided(episode);
  const open = !learnt ? "Nothing learnt yet" : n === 0 ? "Touch something" : withdrawn.length ? "Undecided again" : "Undecided";
  text(place, decision === "unknown" ? capital(named) : named ?? open);
  place.className = !named || doubted ? "undecided" : decision === "unknown" ? "unknown" : "decided";
  const note = episode.touches.at(-1)?.note;
  text(find("reason"), learnt && n ? [sentence, note, withdrawn.at(-1)].filter(Boolean).join(". ") : "");
  show(find("downloads"), n > 0);
  show(find("doubt"), alarmed);
  show(find("limits"), n > 0 && episode.limits !== "");
  text(find("limits"), episode.limits);
  show(find("why"), n > 0 && why.length > 0);
  find("why").querySelector("ul").replaceChildren(...why.map((words) => make("li", {}, unbroken(words))));
}

const capital = (words) => words[0].toUpperCase() + words.slice(1);

function ranked(posterior) {
  return Object.entries(posterior).sort((a, b) => b[1] - a[1]);
}

const hue = (name) => `var(--c${marks.get(name).hue})`;

function drawBars(posterior) {
  const list = find("bars");
  const rows = ranked(posterior).slice(0, SHOWN);
  while (list.children.length > rows.length) list.lastChild.remove();
  while (list.children.length < rows.length) list.append(bar());
  rows.forEach(([name, share], at) => {
    const [mark, label, track, value] = list.children[at].children;
    list.children[at].style.setProperty("--hue", hue(name));
    text(mark, marks.get(name).letters);
    text(label, name);
    label.title = name;
    text(value, percent(share));
    track.setAttribute("aria-label", name);
    track.setAttribute("aria-valuenow", share.toFixed(4));
    track.setAttribute("aria-valuetext", percent(share));
    track.firstChild.style.width = `${100 * share}%`;
  });
}

function bar() {
  const track = make("div", { class: "track", role: "meter", "aria-valuemin": "0", "aria-valuemax": "1" },
    make("div", { class: "fill" }));
  return make("li", {}, make("span", { class: "mark", "aria-hidden": "true" }), make("span", { class: "name" }), track, make("span", { class: "value" }));
}

function drawUnknown(last) {
  const known = last !== undefined && last.unknown !== null;
  show(find("unknown"), known);
  if (!known) return;
  const meter = find("unknown-meter");
  meter.firstElementChild.style.width = `${100 * last.unknown}%`;
  meter.setAttribute("aria-valuenow", last.unknown.toFixed(4));
  meter.setAttribute("aria-valuetext", percent(last.unknown));
  text(find("unknown").querySelector(".value"), percent(last.unknown));
}

function drawHistory() {
  const touches = episode.touches.slice(-WINDOW);
  const believed = touches.filter((touch) => touch.unknown !== null);
  show(find("history"), touches.length > 0);
  const from = touches.length < episode.touches.length ? `: the last ${WINDOW} of ${episode.touches.length}` : "";
  text(find("history-title"), `${believed.length ? "Belief after each touch" : "Touches"}${from}`);
  const chart = find("history").querySelector("svg");
  show(find("columns"), believed.length > 0);
  drawColumns(chart, believed);
  drawStrip(touches);
}

function drawColumns(chart, touches) {
  const top = ranked(touches.at(-1)?.posterior ?? {}).slice(0, SHOWN).map(([name]) => name);
  chart.setAttribute("viewBox", `0 0 ${WINDOW} 1`);
  const letters = [];
  chart.replaceChildren(...touches.flatMap((touch, at) => column(touch, at, top, letters)));
  find("letters").replaceChildren(...letters);
  const described = touches.map((touch) => {
    const [[name, share]] = ranked({ ...touch.posterior, "nothing learnt": touch.unknown });
    return `touch ${touch.number}: ${name} ${percent(share)}`;
  });
  chart.setAttribute("aria-label", `Belief after each touch. ${described.slice(-20).join("; ")}.`);
}

// Objects in their colours, the others together, and nothing learnt on top in grey.
function column(touch, at, top, letters) {
  let above = 0;
  const parts = top.map((name) => [hue(name), touch.posterior[name] ?? 0, marks.get(name).letters]);
  const others = 1 - touch.unknown - parts.reduce((sum, [, share]) => sum + share, 0);
  parts.push([OTHERS, others, "…"], ["var(--soft)", touch.unknown, "?"]);
  return parts.filter(([, share]) => share > 0.002).map(([fill, share, words]) => {
    const block = band(at, above, share, fill);
    if (share >= ROOM) letters.push(letter(words, at, above + share / 2));
    above += share;
    return block;
  });
}

function letter(words, at, middle) {
  const shown = make("span", { class: "mark" }, words);
  shown.style.left = `${100 * (at + 0.5) / WINDOW}%`;
  shown.style.top = `${100 * middle}%`;
  return shown;
}

function band(at, y, height, fill) {
  const block = drawn("rect", { x: at + 0.06, y, width: 0.88, height });
  block.style.fill = fill;
  return block;
}

function drawStrip(touches) {
  // By its time: a server that started again counts from 1, and a browser keeps pictures.
  pictures(find("strip"), touches.map(({ number, miss, time_s: key }) => {
    if (miss) return { key, label: String(number), alt: `Touch ${number} met nothing` };
    const src = url(`episode/touches/${number}/picture?time_s=${key}`);
    const large = `${src}&side=480`;
    return { key, label: String(number), alt: `Touch ${number}`, src,
      open: () => openPicture(large, `Touch ${number}`) };
  }));
}
