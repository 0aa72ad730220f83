// A colour and letters for each name, so that colours need not be told apart.

const HUES = 7;
let known = "";
let marks = new Map();

// Marks of names: where two want the same, the later one takes the next.
export function marked(names) {
  const sorted = [...names].sort();
  if (sorted.join("\n") === known) return marks;
  known = sorted.join("\n");
  marks = new Map();
  for (const name of sorted) marks.set(name, { hue: hueOf(name), letters: lettersOf(name) });
  return marks;
}

function hueOf(name) {
  const taken = [...marks.values()].map((one) => one.hue);
  let wish = [...name].reduce((sum, letter) => (31 * sum + letter.codePointAt(0)) % 9973, 7) % HUES;
  for (let tries = 0; tries < HUES && taken.includes(wish); tries += 1) wish = (wish + 1) % HUES;
  return wish;
}

function lettersOf(name) {
  const taken = new Set([...marks.values()].map((one) => one.letters));
  const [first, ...rest] = [...name];
  const begin = first.toUpperCase();
  const more = rest.filter((letter) => /[\p{L}\p{N}]/u.test(letter)).map((letter) => begin + letter);
  const numbers = Array.from({ length: 999 }, (_, at) => begin + (at + 2));
  return [begin, ...more, ...numbers].find((one) => !taken.has(one)) ?? begin;
}
