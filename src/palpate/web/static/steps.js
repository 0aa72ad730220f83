// Where one is: the step that is marked, the part that comes first, the one next button.

import { find, show } from "./dom.js";

const BUTTONS = ["baseline", "press-keep", "resume", "start", "learn", "fresh", "teach-this"];

export function showSteps(state) {
  const next = buttonOf(state);
  const now = stepOf(state, next);
  for (let number = 1; number <= 3; number += 1) {
    const item = find(`step-${number}`);
    if (number === now) item.setAttribute("aria-current", "step");
    else item.removeAttribute("aria-current");
  }
  const asks = state.model !== null;
  show(find("belief"), state.lesson === null && (asks || state.library === null));
  show(find("fresh"), asks || state.library === null);
  show(find("count"), asks);
  if (document.body.dataset.asks !== String(asks)) arrange(asks);
  BUTTONS.forEach((id) => find(id).classList.toggle("primary", id === next));
}

// While the page hears nothing, no button is next.
export const showNoStep = () => BUTTONS.forEach((id) => find(id).classList.remove("primary"));

function stepOf({ sensor, lesson, model, library, learning }, next) {
  if (sensor && (!sensor.baseline || sensor.press)) return 1;
  if (!library) return model ? 3 : 2;
  if (lesson || learning || !model || ["resume", "learn"].includes(next)) return 2;
  return 3;
}

// What is to be pressed next; nothing where a touch is next.
function buttonOf({ sensor, lesson, model, library, learning, unlearnt, episode, alarm }) {
  if (sensor?.lost) return null;
  if (sensor?.press) return sensor.press.found && !sensor.press.lower ? "press-keep" : null;
  if (sensor && !sensor.baseline) return "baseline";
  if (lesson || learning) return null;
  if (library?.interrupted) return "resume";
  if (library && learnable(library, model) && (unlearnt || isBehind(library, model))) return "learn";
  if (library && !model) return "start";
  // What was withdrawn may have been of another thing; and a sensor that looks changed
  // makes strangers of things that are known.
  if (episode.decision === "unknown" && library && !episode.withdrawn.length && !alarm) return "teach-this";
  return episode.decision === null ? null : "fresh";
}

const taughtTwice = (library) => library.objects.filter((one) => one.n_touches > 1);

// With what the model knows from elsewhere one object that is taught is enough.
export const learnable = (library, model) =>
  new Set([...taughtTwice(library).map((one) => one.name), ...Object.keys(model?.n_elsewhere ?? {})]).size > 1;

// Whether the library holds an object that the model does not know.
const isBehind = (library, model) =>
  taughtTwice(library).some((one) => !model || !model.objects.includes(one.name));

// Once something is learnt "What is it?" comes first, also for the Tab key.
function arrange(asks) {
  document.body.dataset.asks = String(asks);
  const focused = document.activeElement;
  const belief = find("belief");
  belief.parentElement.insertBefore(belief, asks ? find("sensor") : find("objects"));
  if (belief.contains(focused)) focused.focus();
}
