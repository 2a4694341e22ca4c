// Draws the room of the headset: the endoscope's picture on a screen, one half for each eye, and the
// state below it.

const VERTEX = `#version 300 es
uniform mat4 projection, view, place;
in vec2 corner;
out vec2 at;
void main() {
  at = vec2(corner.x + 0.5, 0.5 - corner.y);
  gl_Position = projection * view * place * vec4(corner, 0.0, 1.0);
}`;
const FRAGMENT = `#version 300 es
precision mediump float;
uniform sampler2D picture, blue, red; // the colours as they are, or luma and two differences
uniform bool planes;
uniform vec2 part;   // begin and width of the eye's part of the texture
uniform float shift; // of the eye's picture, as a share of its width
in vec2 at;
out vec4 colour;
void main() {
  float x = at.x + shift;
  bool inside = x >= 0.0 && x <= 1.0;
  vec2 from = vec2(part.x + x * part.y, at.y);
  vec3 seen = texture(picture, from).rgb;
  if (planes) { // ITU-R BT.601, limited range, as codec.py encodes
    float y = 1.164384 * (seen.r - 16.0 / 255.0);
    float b = texture(blue, from).r - 128.0 / 255.0;
    float r = texture(red, from).r - 128.0 / 255.0;
    seen = clamp(vec3(y + 1.596027 * r, y - 0.391762 * b - 0.812968 * r, y + 2.017232 * b), 0.0, 1.0);
  }
  colour = inside ? vec4(seen, 1.0) : vec4(0.0, 0.0, 0.0, 1.0);
}`;
const TEXT = { width: 1024, height: 200 };
const TEXT_BELOW_M = 0.03;
const ROOM = [0.027, 0.035, 0.047, 1];

export class RoomView {
  /**
   * @param gl WebGL2
   * @param widthM width of the screen in the room [m]
   * @param shift of the scene away from the viewer, as a share of the picture's width
   */
  constructor(gl, widthM, shift) {
    this.gl = gl;
    this.widthM = widthM;
    this.shift = shift;
    this.program = linked(gl);
    this.places = Object.fromEntries(
      ["projection", "view", "place", "part", "shift", "planes", "picture", "blue", "red"].map((name) => [name, gl.getUniformLocation(this.program, name)]),
    );
    const corners = gl.createBuffer();
    gl.bindBuffer(gl.ARRAY_BUFFER, corners);
    gl.bufferData(gl.ARRAY_BUFFER, new Float32Array([-0.5, -0.5, 0.5, -0.5, -0.5, 0.5, 0.5, 0.5]), gl.STATIC_DRAW);
    const corner = gl.getAttribLocation(this.program, "corner");
    gl.enableVertexAttribArray(corner);
    gl.vertexAttribPointer(corner, 2, gl.FLOAT, false, 0, 0);
    this.picture = [0, 1, 2].map(() => texture(gl));
    this.planar = false;
    gl.useProgram(this.program);
    ["picture", "blue", "red"].forEach((name, unit) => gl.uniform1i(this.places[name], unit));
    this.text = texture(gl);
    this.textCanvas = Object.assign(document.createElement("canvas"), TEXT);
    this.words = "";
    this.aspect = 4 / 3;
    this.eyes = 2;
  }

  /** The newest picture, as an image or as planes; both eyes side by side, or one eye for both. */
  load({ image, planes, head: { width, height } }, eyes) {
    const { gl } = this;
    this.planar = planes !== undefined;
    if (planes) this.loadPlanes(planes, width, height);
    else {
      gl.bindTexture(gl.TEXTURE_2D, this.picture[0]);
      gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA, gl.RGBA, gl.UNSIGNED_BYTE, image);
    }
    this.eyes = eyes;
    this.aspect = width / eyes / height;
  }

  loadPlanes({ data, layout }, width, height) {
    const { gl } = this;
    gl.pixelStorei(gl.UNPACK_ALIGNMENT, 1);
    layout.forEach(({ offset, stride }, i) => {
      const [wide, high] = i ? [width / 2, height / 2] : [width, height];
      gl.bindTexture(gl.TEXTURE_2D, this.picture[i]);
      gl.pixelStorei(gl.UNPACK_ROW_LENGTH, stride);
      gl.texImage2D(gl.TEXTURE_2D, 0, gl.R8, wide, high, 0, gl.RED, gl.UNSIGNED_BYTE, data, offset);
    });
    gl.pixelStorei(gl.UNPACK_ROW_LENGTH, 0);
    gl.pixelStorei(gl.UNPACK_ALIGNMENT, 4);
  }

  /** The lines below the screen: [text, colour] each. */
  say(lines) {
    const words = JSON.stringify(lines);
    if (words === this.words) return;
    this.words = words;
    const context = this.textCanvas.getContext("2d");
    context.fillStyle = "#07090c";
    context.fillRect(0, 0, TEXT.width, TEXT.height);
    lines.forEach(([text, colour], i) => {
      context.font = i ? "30px system-ui, sans-serif" : "600 44px system-ui, sans-serif";
      context.fillStyle = colour;
      context.fillText(text, 10, [50, 105, 155][i], TEXT.width - 20);
    });
    const { gl } = this;
    gl.bindTexture(gl.TEXTURE_2D, this.text);
    gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA, gl.RGBA, gl.UNSIGNED_BYTE, this.textCanvas);
  }

  /** One frame: `screen` {p, q} in the room. */
  draw(pose, layer, screen) {
    const { gl, places } = this;
    gl.bindFramebuffer(gl.FRAMEBUFFER, layer.framebuffer);
    gl.clearColor(...ROOM);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    gl.useProgram(this.program);
    const height = this.widthM / this.aspect;
    const textHeight = (this.widthM * TEXT.height) / TEXT.width;
    for (const view of pose.views) {
      const { x, y, width, height: rows } = layer.getViewport(view);
      gl.viewport(x, y, width, rows);
      gl.uniformMatrix4fv(places.projection, false, view.projectionMatrix);
      gl.uniformMatrix4fv(places.view, false, view.transform.inverse.matrix);
      const right = view.eye === "right";
      const shift = this.eyes === 2 ? ((right ? -1 : 1) * this.shift) / 2 : 0;
      const part = this.eyes === 2 ? [right ? 0.5 : 0, 0.5] : [0, 1];
      this.quad(this.picture, this.planar, part, shift, placed(screen, 0, this.widthM, height));
      this.quad([this.text], false, [0, 1], 0, placed(screen, -(height + textHeight) / 2 - TEXT_BELOW_M, this.widthM, textHeight));
    }
  }

  quad(from, planar, part, shift, place) {
    const { gl, places } = this;
    from.forEach((each, unit) => {
      gl.activeTexture(gl.TEXTURE0 + unit);
      gl.bindTexture(gl.TEXTURE_2D, each);
    });
    gl.activeTexture(gl.TEXTURE0);
    gl.uniform1i(places.planes, planar ? 1 : 0);
    gl.uniform2fv(places.part, part);
    gl.uniform1f(places.shift, shift);
    gl.uniformMatrix4fv(places.place, false, place);
    gl.drawArrays(gl.TRIANGLE_STRIP, 0, 4);
  }
}

/** Matrix, column by column, of a rectangle at the screen, `up` metres above its middle. */
function placed({ p, q }, up, width, height) {
  const [x, y, z, w] = q;
  const across = [1 - 2 * (y * y + z * z), 2 * (x * y + z * w), 2 * (x * z - y * w)];
  const above = [2 * (x * y - z * w), 1 - 2 * (x * x + z * z), 2 * (y * z + x * w)];
  const at = p.map((part, i) => part + above[i] * up);
  return new Float32Array([
    ...across.map((part) => part * width), 0, ...above.map((part) => part * height), 0, 0, 0, 1, 0, ...at, 1,
  ]);
}

function texture(gl) {
  const made = gl.createTexture();
  gl.bindTexture(gl.TEXTURE_2D, made);
  gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA, 1, 1, 0, gl.RGBA, gl.UNSIGNED_BYTE, new Uint8Array([0, 0, 0, 255]));
  for (const side of [gl.TEXTURE_WRAP_S, gl.TEXTURE_WRAP_T]) gl.texParameteri(gl.TEXTURE_2D, side, gl.CLAMP_TO_EDGE);
  for (const size of [gl.TEXTURE_MIN_FILTER, gl.TEXTURE_MAG_FILTER]) gl.texParameteri(gl.TEXTURE_2D, size, gl.LINEAR);
  return made;
}

function linked(gl) {
  const program = gl.createProgram();
  for (const [kind, source] of [[gl.VERTEX_SHADER, VERTEX], [gl.FRAGMENT_SHADER, FRAGMENT]]) {
    const shader = gl.createShader(kind);
    gl.shaderSource(shader, source);
    gl.compileShader(shader);
    gl.attachShader(program, shader);
  }
  gl.linkProgram(program);
  if (!gl.getProgramParameter(program, gl.LINK_STATUS)) throw new Error(gl.getProgramInfoLog(program));
  return program;
}
