// The page: what the server sends goes to the parts that show it.

import { addTouch, showEpisode, showNearest, startBelief } from "./belief.js";
import { find, say, show } from "./dom.js";
import { showObjects } from "./objects.js";
import { drawFrame, showHealth, showOffline, showSensor, startSensor } from "./sensor.js";
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

history.replaceState(null, "", location.pathname); // the token need not be seen
startSensor();
startBelief();
startTeach();
listen({
  event: (news) => handlers[news.kind]?.(news),
  frame: drawFrame,
  online(whether, refused) {
    show(find("offline"), !whether && !refused);
    show(find("refused"), !whether && refused);
    document.body.dataset.online = String(whether);
    if (!whether) showOffline();
  },
});
