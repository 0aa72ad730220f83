// From above: where touches with a place met something, and what is expected there.

import { get } from "./api.js";
import { drawn, find, show, text } from "./dom.js";

const MARGIN_MM = 12;
const [DOT, REACH] = [0.028, 0.3]; // shares of the width
const ROUND = 72; // turns that look alike: its turn cannot be told

let latest = null;
let asking = false;
let again = false;

// Ask for it where a touch of the episode has a place; once more if there was news.
export async function showAbove(episode) {
  latest = episode;
  const placed = episode.touches.some((touch) => touch.position_mm);
  show(find("above"), placed);
  again = placed && asking;
  if (!placed || asking) return;
  asking = true;
  const seen = await get("episode/above");
  asking = false;
  if (seen && seen.touches.length + seen.misses.length && !find("above").hidden) draw(seen);
  if (again) showAbove(latest);
}

function draw({ sentence, pose, touches, misses, surface }) {
  text(find("above-sentence"), sentence);
  const svg = find("above").querySelector("svg");
  const { left, top, width, height } = frame([...touches, ...misses, ...surface]);
  const size = Math.max(width, height);
  svg.setAttribute("viewBox", `${left} ${top} ${width} ${height}`);
  const at = ({ x_mm, y_mm }) => `at ${Math.round(x_mm)}, ${Math.round(y_mm)} mm`;
  const where = [...touches.map((touch) => `touch ${touch.number} ${at(touch)}`),
    ...misses.map((miss) => `nothing met by touch ${miss.number} ${at(miss)}`)];
  svg.setAttribute("aria-label", `From above. ${sentence} ${where.join("; ")}.`);
  svg.replaceChildren(
    ...surface.map(expected),
    ...(pose ? standing(pose, size) : []),
    ...misses.map((miss) => missed(miss, size)),
    ...touches.flatMap((touch) => met(touch, size)),
    ...scale(left, top + height, size),
  );
}

// What must be seen: everything, with a margin. y is up in the world and down on paper.
function frame(places) {
  const ends = (middle, reach = 0) => [middle - reach, middle + reach];
  const xs = places.flatMap(({ x_mm, long_mm }) => ends(x_mm, long_mm));
  const ys = places.flatMap(({ y_mm, long_mm }) => ends(-y_mm, long_mm));
  const [left, top] = [Math.min(...xs) - MARGIN_MM, Math.min(...ys) - MARGIN_MM];
  const width = Math.max(...xs) + MARGIN_MM - left;
  return { left, top, width, height: Math.max(...ys) + 2 * MARGIN_MM - top };
}

function expected({ x_mm, y_mm, long_mm, short_mm, turn_deg }) {
  const transform = `translate(${x_mm} ${-y_mm}) rotate(${-turn_deg})`;
  return drawn("ellipse", { transform, rx: Math.max(long_mm, 0.5), ry: Math.max(short_mm, 0.5) });
}

// Where its middle is, and a wedge the way that it is turned, where that can be told.
function standing({ turn_rad, turn_sd_rad, symmetry, offset_mm, offset_sd_mm }, size) {
  const [x, y] = [offset_mm[0], -offset_mm[1]];
  const middle = drawn("ellipse", { class: "pose", cx: x, cy: y, rx: offset_sd_mm[0], ry: offset_sd_mm[1] });
  if (symmetry >= ROUND) return [middle];
  const ends = [turn_rad - turn_sd_rad, turn_rad + turn_sd_rad].map((angle) =>
    `${x + REACH * size * Math.cos(angle)} ${y - REACH * size * Math.sin(angle)}`);
  return [middle, drawn("path", { class: "pose", d: `M${ends[0]}L${x} ${y}L${ends[1]}` })];
}

function met({ number, x_mm, y_mm }, size) {
  const place = { transform: `translate(${x_mm} ${-y_mm})` };
  const written = drawn("text", { ...place, "font-size": 1.25 * DOT * size }, String(number));
  return [drawn("circle", { ...place, r: DOT * size }), written];
}

// A cross where the tip ended without having met anything.
function missed({ x_mm, y_mm }, size) {
  const r = DOT * size;
  const d = `M${x_mm - r} ${-y_mm - r}l${2 * r} ${2 * r}m0 ${-2 * r}l${-2 * r} ${2 * r}`;
  return drawn("path", { class: "missed", d, stroke: "currentColor", "stroke-width": r / 3 });
}

// A length to compare with, in the lower left corner.
function scale(left, bottom, size) {
  const length = [100, 50, 20, 10].find((mm) => mm < size / 3) ?? 5;
  const [x, y] = [left + 0.03 * size, bottom - 0.03 * size];
  const line = drawn("path", { d: `M${x} ${y}h${length}`, stroke: "currentColor", "stroke-width": 0.008 * size });
  const words = drawn("text", { class: "scale", x: x + length / 2, y: y - 0.035 * size, "font-size": 0.04 * size }, `${length} mm`);
  return [line, words];
}
