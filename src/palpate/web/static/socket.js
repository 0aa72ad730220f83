// The websocket: events as they come, and a new one when it is lost.

const FIRST_MS = 400;
const LONGEST_MS = 5000;

export function listen({ event, frame, online }) {
  let wait = FIRST_MS;
  const open = () => {
    const scheme = location.protocol === "https:" ? "wss" : "ws";
    const socket = new WebSocket(`${scheme}://${location.host}/ws`);
    socket.binaryType = "arraybuffer";
    socket.onopen = () => {
      wait = FIRST_MS;
      online(true, "");
    };
    socket.onmessage = ({ data }) => {
      if (typeof data === "string") event(JSON.parse(data));
      else frame(...parted(data));
    };
    socket.onclose = async () => {
      online(false, await refused());
      setTimeout(open, wait);
      wait = Math.min(LONGEST_MS, 2 * wait);
    };
  };
  open();
}

// Whether the server answers, but wants another token.
async function refused() {
  const answer = await fetch("/api/health").catch(() => null);
  return answer?.status === 401 || answer?.status === 403;
}

function parted(data) {
  const length = new DataView(data).getUint32(0);
  const head = JSON.parse(new TextDecoder().decode(new Uint8Array(data, 4, length)));
  return [head, new Blob([new Uint8Array(data, 4 + length)], { type: head.type })];
}
