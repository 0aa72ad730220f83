// Several sensors side by side: a live tile each. The page is about the one in its address.

import { draw } from "./sensor.js";
import { here, OF_ALL } from "./api.js";
import { decided, find, make, percent, show, text } from "./dom.js";

const NOTHING_LEARNT = "nothing learnt";
const tiles = new Map();
let taught = ""; // the object of the lesson under way

// Take in news of any sensor, chosen or not.
export function showSensors({ kind, sensor_number: number, sensor, episode, lesson, library }) {
  if (kind === "state" && number === here) taught = lesson?.name ?? "";
  if (kind === "state") OF_ALL.interrupted[library?.interrupted ? "add" : "delete"](number);
  if (!tiles.has(number)) addTile(number);
  const tile = tiles.get(number);
  if (sensor) {
    text(tile.name, `${number} ${sensor.name}`);
    text(tile.contact, sensor.lost ? "no frames" : sensor.touching ? "touching" : sensor.baseline ? "no contact" : "no baseline");
    tile.contact.className = sensor.lost ? "pill off" : sensor.touching ? "pill on" : "pill";
    text(tile.lost, sensor.lost);
    OF_ALL.desks.set(number, sensor.desk);
    showMixed();
  }
  if (!episode) return;
  const last = episode.touches.at(-1);
  tile.belief = last?.unknown === null || !last ? null : { ...last, strangers: episode.strangers };
  text(tile.words, decided(episode) ?? (tile.belief ? `${worded(withUnknown(last), 1)}?` : ""));
  showTogether();
}

export const drawTile = ({ sensor_number: number }, bitmap, array) => {
  if (tiles.has(number)) draw(tiles.get(number).canvas, bitmap, array);
};

function addTile(number) {
  const parts = { canvas: make("canvas", { role: "img", "aria-label": `Live image of sensor ${number}` }), name: make("b"),
    contact: make("span", { class: "pill" }), words: make("span", { class: "tile-belief" }), lost: make("span", { class: "soft" }) };
  const link = make("a", { href: number === 1 ? "/" : `/?sensor=${number}`, class: "tile" }, ...Object.values(parts));
  if (number === here) link.setAttribute("aria-current", "true");
  tiles.set(number, { ...parts, belief: null });
  find("tiles").append(link);
  show(find("sensors"), tiles.size > 1);
  OF_ALL.count = tiles.size;
}

// What lies before the sensors, where that differs and all of them are taught, or is
// another thing of theirs than the one that is taught or named; else "".
export function mixed() {
  const desk = OF_ALL.desks.get(here);
  const named = nameTaught();
  if (OF_ALL.count < 2 || !find("as-one").checked) {
    return desk?.placed && desk.placed !== named && desk.objects.includes(named) ? desk.placed : "";
  }
  const placed = [...OF_ALL.desks].filter(([, desk]) => desk?.placed).sort(([a], [b]) => a - b)
    .map(([number, desk]) => [number, desk.placed]);
  return new Set(placed.map(([, name]) => name)).size > 1 ? placed.map((one) => one.join(": ")).join(", ") : "";
}

const nameTaught = () => taught || find("name").value.trim();

// Whether all that are taught can have the same thing before them.
export function canPlace(name) {
  const desks = OF_ALL.count < 2 || !find("as-one").checked ? [OF_ALL.desks.get(here)] : [...OF_ALL.desks.values()];
  return desks.every((desk) => desk?.objects.includes(name));
}

export function showMixed() {
  const words = mixed();
  show(find("mixed"), words !== "");
  if (OF_ALL.count < 2 || !find("as-one").checked) {
    const are = taught ? "are" : "would be";
    text(find("mixed"), words && `On the desk lies ${words}: its touches ${are} stored as ${nameTaught()}.${taught ? "" : " Start asks whether to put that there."}`);
    return;
  }
  text(find("mixed"), words && `Different things lie before the sensors (${words}): all would be stored under one name. `
    + "Put the same before all of them, or untick “with all of them”.");
}

const worded = (shares, count) => Object.entries(shares).sort((a, b) => b[1] - a[1]).slice(0, count)
  .map(([name, share]) => `${name} ${percent(share)}`).join(", ");

const withUnknown = ({ posterior, unknown }) => ({ ...posterior, [NOTHING_LEARNT]: unknown });

// Independent evidence adds up: what all models know and nothing learnt, each as probable
// as before the first touch, times how much more or less probable every sensor made it.
function showTogether() {
  const beliefs = [...tiles.values()].map((tile) => tile.belief).filter(Boolean);
  const names = beliefs.length > 1 ? Object.keys(beliefs[0].posterior).filter((name) => beliefs.every((one) => name in one.posterior)) : [];
  show(find("together"), names.length > 1);
  if (names.length < 2) return;
  const logs = names.map((name) => product(beliefs.map(({ posterior, strangers }) => [posterior[name], (1 - strangers) / Object.keys(posterior).length])));
  logs.push(product(beliefs.map(({ unknown, strangers }) => [unknown, strangers])));
  const most = Math.max(...logs);
  const weights = logs.map((log) => Math.exp(log - most));
  const whole = weights.reduce((sum, weight) => sum + weight, 0);
  const shares = Object.fromEntries([...names, NOTHING_LEARNT].map((name, at) => [name, weights[at] / whole]));
  text(find("together"), `All together: ${worded(shares, 3)}`);
}

// The logarithm of the first prior times all ratios of posterior to prior.
function product(pairs) {
  const log = (share) => Math.log(Math.max(share, 1e-300));
  return pairs.reduce((sum, [share, prior]) => sum + log(share) - log(prior), log(pairs[0][1]));
}
