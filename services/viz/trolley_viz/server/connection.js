// A connection of a piece of the page to the viewer: made again when it is lost, and given up for
// good with `left` when the piece is not in the page any more.
function trolleyConnection(root, path, client, { opened, heard, lost, left }) {
  const RETRY_MS = 1000;
  let socket = null, retry = null;

  function isGone() {
    if (root.isConnected) return false;
    left();
    close();
    return true;
  }

  function open() {
    if (isGone()) return;
    const url = new URL(path, location.href);
    url.protocol = url.protocol === "https:" ? "wss:" : "ws:";
    url.search = `?client=${client}`;
    url.hash = "";
    const mine = (socket = new WebSocket(url));
    mine.onopen = () => mine === socket && opened();
    mine.onmessage = (event) => {
      if (!isGone() && mine === socket) heard(JSON.parse(event.data));
    };
    mine.onclose = () => {
      if (mine !== socket) return;
      socket = null;
      lost();
      retry = setTimeout(open, RETRY_MS);
    };
  }

  function close() {
    clearTimeout(retry);
    const closed = socket;
    socket = null;
    if (closed !== null) closed.close();
  }

  // More than `maxWaiting` bytes are not sent behind what the connection does not get rid of.
  function say(said, maxWaiting = Infinity) {
    const isOpen = socket !== null && socket.readyState === WebSocket.OPEN;
    if (isOpen && socket.bufferedAmount <= maxWaiting) socket.send(JSON.stringify(said));
  }

  return { open, close, say, isGone };
}
