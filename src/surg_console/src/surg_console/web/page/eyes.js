// Draws a stereo picture (left and right eye side by side, or the left one for both) in the format of
// a display, on a 2D canvas. Without a graphics card a 2D canvas is several times faster than a shader.

/** Formats of displays, with their names for people. */
export const FORMATS = {
  left: "Left eye",
  right: "Right eye",
  sbs: "Side by side",
  top_bottom: "Top and bottom",
  rows: "Rows",
  columns: "Columns",
  checker: "Checkerboard",
  anaglyph: "Anaglyph (red, cyan)",
  frame_packed: "Frame packing",
};

const PACKED_GAP = 45 / 2205; // of the height of a frame-packed picture, between the eyes (HDMI 1.4a)
const WHOLE = [0, 0, 1, 1];
const HALVES = {
  sbs: [[0, 0, 0.5, 1], [0.5, 0, 0.5, 1]],
  top_bottom: [[0, 0, 1, 0.5], [0, 0.5, 1, 0.5]],
  frame_packed: [[0, 0, 1, (1 - PACKED_GAP) / 2], [0, (1 + PACKED_GAP) / 2, 1, (1 - PACKED_GAP) / 2]],
};
/** Whether the first (left) eye has a pixel; the other eye has the rest. */
const MASKS = {
  rows: (x, y) => y % 2 === 0,
  columns: (x) => x % 2 === 0,
  checker: (x, y) => (x + y) % 2 === 0,
};

/** Parts of the canvas, as shares [x, y, width, height], that each eye sees. */
export function regions(format) {
  return HALVES[format] ?? [WHOLE];
}

/** Largest place of an eye of this shape in a region; a half is stretched by the display. */
function place([x, y, w, h], format, canvas, aspect) {
  const packed = format === "frame_packed";
  const height = packed ? canvas.height * h : canvas.height;
  const fitted = Math.min(canvas.width, height * aspect) / canvas.width; // share of the width
  const share = (fitted * canvas.width) / aspect / height; // share of the height
  return [
    Math.round(canvas.width * (x + (w * (1 - fitted)) / 2)),
    Math.round(canvas.height * (y + (h * (1 - share)) / 2)),
    Math.round(canvas.width * w * fitted),
    Math.round(canvas.height * h * share),
  ];
}

export class Display {
  /** @param canvas on which pictures are drawn; its size is the display's, in physical pixels */
  constructor(canvas) {
    this.canvas = canvas;
    this.context = canvas.getContext("2d", { alpha: false, desynchronized: true });
    this.scratch = null; // holds one eye: {canvas, context, mask, key}
    this.cleared = "";
  }

  /**
   * @param image VideoFrame, ImageBitmap or canvas: `eyes` side by side, of `width` × `height`
   * @param format one of FORMATS
   * @param shift of the scene away from the viewer, as a share of an eye's width
   * @param swap whether the right eye comes first
   */
  draw(image, { width, height }, { format, shift = 0, swap = false, eyes = 2 }) {
    const { canvas, context } = this;
    const key = `${canvas.width} ${canvas.height} ${width} ${height} ${format} ${shift} ${eyes}`;
    if (key !== this.cleared) {
      context.fillStyle = "#000";
      context.fillRect(0, 0, canvas.width, canvas.height);
      this.cleared = key;
    }
    const eye = (which, into, where, smooth = true) => {
      const half = width / eyes;
      const cut = Math.abs(shift) / 2;
      const leftEdge = (which === 0) === shift > 0; // the eye loses its left edge, or its right
      const [x, y, w, h] = where;
      const from = (which % eyes) * half + (leftEdge ? cut * half : 0);
      into.imageSmoothingEnabled = smooth;
      into.drawImage(image, from, 0, half * (1 - cut), height, leftEdge ? x : x + cut * w, y, w * (1 - cut), h);
    };
    const aspect = width / eyes / height;
    const parts = regions(format).map((part) => place(part, format, canvas, aspect));
    const [first, second] = swap ? [1, 0] : [0, 1];
    if (format === "left" || format === "right") eye(format === "left" ? first : second, context, parts[0]);
    else if (format === "anaglyph") this.anaglyph(eye, first, second, parts[0]);
    else if (format in MASKS) this.interleaved(eye, first, second, parts[0], format);
    else parts.forEach((part, i) => eye(i ? second : first, context, part));
  }

  /** A canvas of the display's size; `what` it is prepared for is remembered. */
  second(what, prepare) {
    const { width, height } = this.canvas;
    const key = `${what} ${width} ${height}`;
    if (this.scratch?.key !== key) {
      const canvas = new OffscreenCanvas(width, height);
      this.scratch = { key, canvas, context: canvas.getContext("2d"), more: prepare?.(width, height) };
    }
    return this.scratch;
  }

  anaglyph(eye, first, second, where) {
    const other = this.second("anaglyph");
    const tint = (context, colour) => {
      context.globalCompositeOperation = "multiply";
      context.fillStyle = colour;
      context.fillRect(...where);
      context.globalCompositeOperation = "source-over";
    };
    this.black(this.context, where);
    this.black(other.context, where);
    eye(first, this.context, where);
    tint(this.context, "#f00");
    eye(second, other.context, where);
    tint(other.context, "#0ff");
    this.context.globalCompositeOperation = "lighter";
    this.context.drawImage(other.canvas, 0, 0);
    this.context.globalCompositeOperation = "source-over";
  }

  interleaved(eye, first, second, where, format) {
    const { context } = this;
    const other = this.second(format, (width, height) => maskOf(MASKS[format], width, height));
    const layer = other.context;
    layer.globalCompositeOperation = "copy";
    layer.drawImage(other.more, 0, 0);
    layer.globalCompositeOperation = "source-atop"; // keeps the mask's alpha, and its black
    eye(first, layer, where);
    this.black(context, where);
    eye(second, context, where);
    context.drawImage(other.canvas, 0, 0);
  }

  /** What a shifted eye leaves free stays black. */
  black(context, where) {
    context.globalCompositeOperation = "source-over";
    context.fillStyle = "#000";
    context.fillRect(...where);
  }
}

/** A canvas that is opaque where the first eye is. */
function maskOf(belongs, width, height) {
  const pixels = new ImageData(width, height);
  for (let y = 0; y < height; y += 1) {
    for (let x = 0; x < width; x += 1) pixels.data[4 * (y * width + x) + 3] = belongs(x, y) ? 255 : 0;
  }
  const canvas = new OffscreenCanvas(width, height);
  canvas.getContext("2d").putImageData(pixels, 0, 0);
  return canvas;
}
