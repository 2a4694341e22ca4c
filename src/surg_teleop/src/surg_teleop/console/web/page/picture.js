// The worker that receives, decodes and draws the endoscope's pictures; the page's own thread is
// free for the hand. H.264 by WebCodecs; JPEG where the browser has none.

const HEADER_BYTES = 48;
const CODECS = ["h264", "jpeg"];
const AGAIN_MS = 1000;

let canvas = null;
let context = null;
let settings = null; // {url, token, layout, codec}
let socket = null;
let decoder = null;
let configured = "";
const underWay = new Map(); // exposure stamp [us] -> picture's head

onmessage = ({ data }) => {
  if (data.canvas) {
    canvas = data.canvas;
    context = canvas.getContext("2d", { alpha: false, desynchronized: true });
  }
  settings = { ...settings, ...data.settings };
  if (settings.codec === "h264" && !("VideoDecoder" in self)) settings.codec = "jpeg";
  if (socket) watch();
  else connect();
};

const wallUs = () => (performance.timeOrigin + performance.now()) * 1000;

function say(what, keys) {
  if (socket?.readyState === WebSocket.OPEN) socket.send(JSON.stringify({ say: what, ...keys }));
}

function watch() {
  forget();
  say("watch", { layout: settings.layout, codec: settings.codec });
}

function connect() {
  socket = new WebSocket(settings.url);
  socket.binaryType = "arraybuffer";
  socket.onopen = () => {
    say("hello", { token: settings.token });
    watch();
  };
  socket.onmessage = (event) => receive(event.data);
  socket.onclose = () => setTimeout(connect, AGAIN_MS);
}

/** Head and bytes of a picture, as picture_packet.py packs them. */
function unpack(buffer) {
  const view = new DataView(buffer);
  const hex = (at) => view.getUint8(at).toString(16).padStart(2, "0");
  return {
    codec: CODECS[view.getUint8(5)],
    key: view.getUint8(6) === 1,
    profile: hex(8) + hex(9) + hex(10),
    width: view.getUint16(12, true),
    height: view.getUint16(14, true),
    seq: view.getUint32(16, true),
    exposedUs: Number(view.getBigInt64(20, true)),
    receivedUs: Number(view.getBigInt64(28, true)),
    encodedUs: Number(view.getBigInt64(36, true)),
    arrivedUs: wallUs(),
    data: new Uint8Array(buffer, HEADER_BYTES),
  };
}

async function receive(buffer) {
  const head = unpack(buffer);
  if (head.codec !== settings.codec) return; // sent before the last request
  if (head.codec === "jpeg") {
    draw(await createImageBitmap(new Blob([head.data], { type: "image/jpeg" })), head);
    return;
  }
  try {
    decode(head);
  } catch (error) {
    fallBack(error);
  }
}

function decode(head) {
  const wanted = `${head.profile} ${head.width} ${head.height}`;
  if (head.key && (wanted !== configured || decoder?.state !== "configured")) {
    forget();
    decoder = new VideoDecoder({ output: decoded, error: fallBack });
    decoder.configure({
      codec: `avc1.${head.profile}`,
      codedWidth: head.width,
      codedHeight: head.height,
      optimizeForLatency: true,
    });
    configured = wanted;
  }
  if (decoder?.state !== "configured") return; // wait for a key picture
  underWay.set(head.exposedUs, head);
  const type = head.key ? "key" : "delta";
  decoder.decode(new EncodedVideoChunk({ type, timestamp: head.exposedUs, data: head.data }));
}

function decoded(frame) {
  const head = underWay.get(frame.timestamp);
  for (const stamp of underWay.keys()) if (stamp <= frame.timestamp) underWay.delete(stamp);
  if (head) draw(frame, head);
  else frame.close();
}

function draw(image, head) {
  if (canvas.width !== head.width || canvas.height !== head.height) {
    canvas.width = head.width;
    canvas.height = head.height;
  }
  context.drawImage(image, 0, 0);
  image.close();
  say("shown", { seq: head.seq });
  const { data, ...facts } = head; // the bytes stay here
  postMessage({ ...facts, drawnUs: wallUs() });
}

function forget() {
  if (decoder && decoder.state !== "closed") decoder.close();
  decoder = null;
  configured = "";
  underWay.clear();
}

/** The decoder has failed: continue with JPEG. */
function fallBack(error) {
  if (settings.codec !== "h264") return;
  settings.codec = "jpeg";
  postMessage({ trouble: `This browser cannot decode H.264 (${error.message}). Using JPEG.` });
  watch();
}
