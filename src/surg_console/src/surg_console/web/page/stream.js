// Receives and decodes the endoscope's pictures, for the workers of all pages. H.264 by WebCodecs;
// JPEG where the browser has none.

const HEADER_BYTES = 48;
const CODECS = ["h264", "jpeg"];
const AGAIN_MS = 1000;

export const wallUs = () => (performance.timeOrigin + performance.now()) * 1000;

export class PictureStream {
  /**
   * @param draw called with every picture (VideoFrame or ImageBitmap, to be closed) and its head
   * @param tell called with a message for the page
   */
  constructor(draw, tell) {
    this.draw = draw;
    this.tell = tell;
    this.settings = null; // {url, token, layout, codec, spacing}
    this.socket = null;
    this.decoder = null;
    this.configured = "";
    this.underWay = new Map(); // exposure stamp [us] -> picture's head
  }

  /** Change what is watched; the first call connects. */
  update(settings) {
    const before = this.settings;
    this.settings = { ...before, ...settings };
    if (this.settings.codec === "h264" && !("VideoDecoder" in self)) this.settings.codec = "jpeg";
    if (this.socket) this.watch(before.layout === this.settings.layout);
    else this.connect();
  }

  say(what, keys) {
    if (this.socket?.readyState === WebSocket.OPEN) this.socket.send(JSON.stringify({ say: what, ...keys }));
  }

  /** A picture is on the screen: the next one may come. */
  shown(head) {
    this.say("shown", { seq: head.seq });
  }

  /** Ask for pictures; where they are `the same`, more of them or fewer, each still builds on the last. */
  watch(theSame = false) {
    if (!theSame) this.forget();
    const { layout, codec, spacing } = this.settings;
    this.say("watch", { layout, codec, spacing });
  }

  connect() {
    const socket = new WebSocket(this.settings.url);
    this.socket = socket;
    socket.binaryType = "arraybuffer";
    socket.onopen = () => {
      this.say("hello", { token: this.settings.token });
      this.watch();
    };
    socket.onmessage = (event) => this.receive(event.data);
    socket.onclose = () => setTimeout(() => this.connect(), AGAIN_MS);
  }

  async receive(buffer) {
    const head = unpack(buffer);
    if (head.codec !== this.settings.codec) return; // sent before the last request
    if (head.codec === "jpeg") {
      this.draw(await createImageBitmap(new Blob([head.data], { type: "image/jpeg" })), facts(head));
      return;
    }
    try {
      this.decode(head);
    } catch (error) {
      this.fallBack(error);
    }
  }

  decode(head) {
    const wanted = `${head.profile} ${head.width} ${head.height}`;
    if (head.key && (wanted !== this.configured || this.decoder?.state !== "configured")) {
      this.forget();
      this.decoder = new VideoDecoder({
        output: (frame) => this.decoded(frame),
        error: (error) => this.fallBack(error),
      });
      this.decoder.configure({
        codec: `avc1.${head.profile}`,
        codedWidth: head.width,
        codedHeight: head.height,
        optimizeForLatency: true,
      });
      this.configured = wanted;
    }
    if (this.decoder?.state !== "configured") return; // wait for a key picture
    this.underWay.set(head.exposedUs, head);
    const type = head.key ? "key" : "delta";
    this.decoder.decode(new EncodedVideoChunk({ type, timestamp: head.exposedUs, data: head.data }));
  }

  decoded(frame) {
    const head = this.underWay.get(frame.timestamp);
    for (const stamp of this.underWay.keys()) if (stamp <= frame.timestamp) this.underWay.delete(stamp);
    if (head) this.draw(frame, facts(head));
    else frame.close();
  }

  forget() {
    if (this.decoder && this.decoder.state !== "closed") this.decoder.close();
    this.decoder = null;
    this.configured = "";
    this.underWay.clear();
  }

  /** The decoder has failed: continue with JPEG. */
  fallBack(error) {
    if (this.settings.codec !== "h264") return;
    this.settings.codec = "jpeg";
    this.tell({ trouble: `This browser cannot decode H.264 (${error.message}). Using JPEG.` });
    this.watch();
  }
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

/** The head without the bytes. */
function facts({ data, ...others }) {
  return others;
}
