// Several sensors side by side: a live tile each. The page is about the one in its address.

import { draw } from "./sensor.js";
import { here, OF_ALL } from "./api.js";
import { find, make, percent, show, text } from "./dom.js";

const tiles = new Map();

// Take in news of any sensor, chosen or not.
export function showSensors({ kind, sensor_number: number, sensor, episode }) {
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
  const last = episode.touches.at(-1)?.posterior ?? {};
  tile.posterior = kind === "touch" || episode.touches.length ? last : {};
  text(tile.belief, episode.decision ?? (Object.keys(last).length ? `${worded(last, 1)}?` : ""));
  showTogether();
}

export const drawTile = ({ sensor_number: number }, bitmap, array) => {
  if (tiles.has(number)) draw(tiles.get(number).canvas, bitmap, array);
};

function addTile(number) {
  const parts = { canvas: make("canvas", { role: "img", "aria-label": `Live image of sensor ${number}` }), name: make("b"),
    contact: make("span", { class: "pill" }), belief: make("span", { class: "tile-belief" }), lost: make("span", { class: "soft" }) };
  const link = make("a", { href: number === 1 ? "/" : `/?sensor=${number}`, class: "tile" }, ...Object.values(parts));
  if (number === here) link.setAttribute("aria-current", "true");
  tiles.set(number, { ...parts, posterior: {} });
  find("tiles").append(link);
  show(find("sensors"), tiles.size > 1);
  OF_ALL.count = tiles.size;
}

// What lies before the sensors, where that differs and all of them are taught; else "".
export function mixed() {
  if (OF_ALL.count < 2 || !find("as-one").checked) return "";
  const placed = [...OF_ALL.desks].filter(([, desk]) => desk?.placed).sort(([a], [b]) => a - b)
    .map(([number, desk]) => [number, desk.placed]);
  return new Set(placed.map(([, name]) => name)).size > 1 ? placed.map((one) => one.join(": ")).join(", ") : "";
}

export function showMixed() {
  const words = mixed();
  show(find("mixed"), words !== "");
  text(find("mixed"), words && `Different things lie before the sensors (${words}): all would be stored under one name. `
    + "Put the same before all of them, or untick “with all of them”.");
}

const worded = (posterior, count) => Object.entries(posterior).sort((a, b) => b[1] - a[1]).slice(0, count)
  .map(([name, share]) => `${name} ${percent(share)}`).join(", ");

// Independent evidence adds up: the product of beliefs over what all models know.
function showTogether() {
  const beliefs = [...tiles.values()].map((tile) => tile.posterior).filter((one) => Object.keys(one).length);
  const names = beliefs.length > 1 ? Object.keys(beliefs[0]).filter((name) => beliefs.every((one) => name in one)) : [];
  const sums = names.map((name) => beliefs.reduce((sum, one) => sum + Math.log(Math.max(one[name], 1e-300)), 0));
  const shares = sums.map((sum) => Math.exp(sum - Math.max(...sums)));
  const whole = shares.reduce((sum, share) => sum + share, 0);
  show(find("together"), names.length > 1);
  text(find("together"), `All together: ${worded(Object.fromEntries(names.map((name, at) => [name, shares[at] / whole])), 3)}`);
}
