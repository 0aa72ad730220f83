// The websocket: events as they come, and a new one when it is lost, or says nothing.

const FIRST_MS = 400;
const LONGEST_MS = 5000;
const SILENT_MS = 10000;  // after a computer has slept nothing tells that it is lost

export function listen({ event, frame, online }) {
  let wait = FIRST_MS;
  const open = () => {
    const scheme = location.protocol === "https:" ? "wss" : "ws";
    const socket = new WebSocket(`${scheme}://${location.host}/ws`);
    let heard = true;
    const lost = async () => {
      clearInterval(asking);
      socket.onopen = socket.onmessage = socket.onclose = null;
      socket.close();
      online(false, await refused());
      setTimeout(open, wait);
      wait = Math.min(LONGEST_MS, 2 * wait);
    };
    const asking = setInterval(() => {
      if (!heard) {
        lost();
        return;
      }
      heard = false;
      if (socket.readyState === WebSocket.OPEN) socket.send("ping");
    }, SILENT_MS);
    socket.binaryType = "arraybuffer";
    socket.onopen = () => {
      wait = FIRST_MS;
      online(true, "");
    };
    socket.onmessage = ({ data }) => {
      heard = true;
      if (typeof data === "string") event(JSON.parse(data));
      else frame(...parted(data));
    };
    socket.onclose = lost;
  };
  open();
}

// Whether the server answers, but wants another token.
async function refused() {
  const answer = await fetch("/api/health", { signal: AbortSignal.timeout(LONGEST_MS) }).catch(() => null);
  return answer?.status === 401 || answer?.status === 403;
}

function parted(data) {
  const length = new DataView(data).getUint32(0);
  const head = JSON.parse(new TextDecoder().decode(new Uint8Array(data, 4, length)));
  return [head, new Blob([new Uint8Array(data, 4 + length)], { type: head.type })];
}
