// The page: what the server sends goes to the parts that show it.

import { here, url } from "./api.js";
import { addTouch, showEpisode, showNearest, startBelief } from "./belief.js";
import { find, say, show } from "./dom.js";
import { showObjects } from "./objects.js";
import { drawFrame, showHealth, showOffline, showSensor, startSensor } from "./sensor.js";
import { drawTile, showSensors } from "./sensors.js";
import { listen } from "./socket.js";
import { showTeach, startTeach } from "./teach.js";

let message = null;

const handlers = {
  state(state) {
    showSensor(state.sensor);
    showHealth(state.health);
    showEpisode(state.episode);
    showNearest(state.nearest);
    showTeach(state);
    showObjects(state);
    if (message !== null && state.message !== message && state.message) say(state.message);
    message = state.message;
  },
  touch({ episode, nearest }) {
    addTouch(episode);
    showNearest(nearest);
  },
  contact({ sensor, health }) {
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
    if (!whether) showOffline();
  },
});
