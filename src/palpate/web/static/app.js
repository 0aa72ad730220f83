// The page: what the server sends goes to the parts that show it.

import { here, url } from "./api.js";
import { addTouch, currentEpisode, showEpisode, showNearest, startBelief } from "./belief.js";
import { find, say, show, text } from "./dom.js";
import { startEditor } from "./editor.js";
import { doubtObjects, showObjects, startObjects } from "./objects.js";
import { drawFrame, showHealth, showOffline, showSensor, startSensor } from "./sensor.js";
import { drawTile, showMixed, showSensors } from "./sensors.js";
import { listen } from "./socket.js";
import { showNoStep, showSteps } from "./steps.js";
import { showTeach, startTeach } from "./teach.js";

let message = null;
let newest = null;

const handlers = {
  state(state) {
    newest = state;
    showSteps(state);
    showSensor(state.sensor);
    showHealth(state.health);
    showTeach(state);
    showEpisode(state.episode, state.alarm);
    showNearest(state.nearest);
    showObjects(state);
    show(find("trouble"), state.trouble !== "");
    text(find("trouble"), state.trouble);
    if (message !== null && ![message, state.trouble, ""].includes(state.message)) say(state.message);
    message = state.message;
  },
  async touch({ episode, nearest }) {
    showNearest(nearest);
    await addTouch(episode);
    if (newest) showSteps({ ...newest, episode: currentEpisode() });
  },
  contact({ sensor, health }) {
    const changed = newest?.sensor && newest.sensor.lost !== sensor.lost;
    if (newest) showSteps(newest = { ...newest, sensor, episode: currentEpisode() });
    if (changed) showTeach(newest);
    showSensor(sensor);
    showHealth(health);
  },
};

// The token need not be seen.
history.replaceState(null, "", here > 1 ? `/?sensor=${here}` : "/");
document.querySelectorAll(".menu a").forEach((link) => { link.href = url(link.getAttribute("href").slice(5)); });
startSensor();
startBelief();
startTeach();
startObjects();
startEditor();
find("as-one").addEventListener("change", showMixed);
find("name").addEventListener("input", showMixed);
document.addEventListener("keydown", (event) => {
  const open = event.key === "Escape" && document.querySelector("details.menu[open]");
  if (!open) return;
  open.open = false;
  open.querySelector("summary").focus();
});
listen({
  event(news) {
    if (news.sensor_number) showSensors(news);
    if (news.sensor_number === here) handlers[news.kind]?.(news);
  },
  frame: (head, picture) => drawFrame(head, picture, drawTile),
  online(whether, refused) {
    show(find("offline"), !whether && !refused);
    show(find("refused"), !whether && refused);
    document.body.dataset.online = String(whether);
    for (const part of [find("steps"), document.querySelector("main")]) part.inert = !whether;
    if (whether) return;
    doubtObjects();
    showOffline();
    showNoStep();
  },
});
