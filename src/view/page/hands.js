// Draws hands with WebGL: in panels of their own, and on the image as the camera sees them.

const VERTEX = `
attribute vec3 position, normal, color;
uniform mat3 turn;
uniform vec3 middle, scale;
uniform bool flat_;
varying vec3 n, c;
void main() {
  vec3 p = flat_ ? position : turn * (position - middle);
  gl_Position = flat_ ? vec4(position.xy, position.z, 1.0) : vec4(p * scale, 1.0);
  n = turn * normal;
  c = color;
}`;

// The light of the program's other pictures (src/render/raster.rs), in linear light.
const FRAGMENT = `
precision mediump float;
varying vec3 n, c;
uniform float opacity;
uniform bool flat_;
void main() {
  vec3 m = normalize(n);
  float light = 0.22 + 0.68 * max(dot(m, vec3(-0.43, 0.52, 0.74)), 0.0) + 0.22 * max(dot(m, vec3(0.63, -0.21, 0.75)), 0.0);
  vec3 shaded = flat_ ? c : c * light * (0.65 + 0.35 * clamp(m.z, 0.0, 1.0));
  gl_FragColor = vec4(pow(shaded, vec3(1.0 / 2.2)), 1.0) * opacity;
}`;

/** Height and width of a hand with its fingers stretched, m, with a margin, and above it room for a line of text. */
const [HEIGHT, WIDTH] = [0.262, 0.2];
/** Middle of a panel, m: between wrist and fingertips. */
const MIDDLE = [0, 0.088, 0];
/** Height of a row of panels, pixels. */
const ROW = 340;

function program(gl) {
  const made = gl.createProgram();
  for (const [kind, text] of [[gl.VERTEX_SHADER, VERTEX], [gl.FRAGMENT_SHADER, FRAGMENT]]) {
    const shader = gl.createShader(kind);
    gl.shaderSource(shader, text);
    gl.compileShader(shader);
    if (!gl.getShaderParameter(shader, gl.COMPILE_STATUS)) throw new Error(gl.getShaderInfoLog(shader));
    gl.attachShader(made, shader);
  }
  gl.linkProgram(made);
  gl.useProgram(made);
  return made;
}

/** Normals of a mesh: the sum of the normals of the triangles at each vertex. */
function normals(positions, faces) {
  const sums = new Float32Array(positions.length);
  for (let f = 0; f < faces.length; f += 3) {
    const [a, b, c] = [3 * faces[f], 3 * faces[f + 1], 3 * faces[f + 2]];
    const ux = positions[b] - positions[a], uy = positions[b + 1] - positions[a + 1], uz = positions[b + 2] - positions[a + 2];
    const vx = positions[c] - positions[a], vy = positions[c + 1] - positions[a + 1], vz = positions[c + 2] - positions[a + 2];
    const nx = uy * vz - uz * vy, ny = uz * vx - ux * vz, nz = ux * vy - uy * vx;
    for (const at of [a, b, c]) {
      sums[at] += nx;
      sums[at + 1] += ny;
      sums[at + 2] += nz;
    }
  }
  return sums;
}

class Canvas {
  constructor(canvas, alpha) {
    this.canvas = canvas;
    const gl = canvas.getContext("webgl", { alpha, antialias: true, premultipliedAlpha: true });
    if (!gl) throw new Error("This browser has no WebGL: hands can't be drawn.");
    this.gl = gl;
    this.program = program(gl);
    this.buffers = Object.fromEntries(["position", "normal", "color"].map(name => [name, gl.createBuffer()]));
    this.places = Object.fromEntries(Object.keys(this.buffers).map(name => [name, gl.getAttribLocation(this.program, name)]));
    this.uniforms = {};
    this.faces = gl.createBuffer();
    gl.enable(gl.DEPTH_TEST);
  }

  mesh(name, values) {
    const { gl } = this;
    const place = this.places[name];
    gl.bindBuffer(gl.ARRAY_BUFFER, this.buffers[name]);
    gl.bufferData(gl.ARRAY_BUFFER, values, gl.DYNAMIC_DRAW);
    if (place < 0) return;
    gl.enableVertexAttribArray(place);
    gl.vertexAttribPointer(place, 3, gl.FLOAT, false, 0, 0);
  }

  triangles(faces) {
    const { gl } = this;
    gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, this.faces);
    gl.bufferData(gl.ELEMENT_ARRAY_BUFFER, faces, gl.DYNAMIC_DRAW);
    gl.drawElements(gl.TRIANGLES, faces.length, gl.UNSIGNED_SHORT, 0);
  }

  uniform(name) {
    return this.uniforms[name] ??= this.gl.getUniformLocation(this.program, name);
  }
}

/** Panels of hands, each turned as the user drags them. */
export class HandPanels extends Canvas {
  constructor(canvas, onTurn) {
    super(canvas, false);
    this.angles = [0, 0];
    canvas.addEventListener("pointerdown", event => canvas.setPointerCapture(event.pointerId));
    canvas.addEventListener("pointermove", event => {
      if (!event.buttons) return;
      this.angles[0] += event.movementX / 120;
      this.angles[1] = Math.max(-1.5, Math.min(1.5, this.angles[1] + event.movementY / 120));
      onTurn();
    });
    canvas.addEventListener("dblclick", () => {
      this.angles = [0, 0];
      onTurn();
    });
  }

  /** Draws rows of panels; a panel is { mesh, positions, colors }. */
  draw(rows) {
    const { gl, canvas } = this;
    if (canvas.height !== ROW * rows.length) canvas.height = ROW * rows.length;
    gl.viewport(0, 0, canvas.width, canvas.height);
    gl.clearColor(1, 1, 1, 1);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    const [yaw, pitch] = this.angles;
    const [cy, sy, cp, sp] = [Math.cos(yaw), Math.sin(yaw), Math.cos(pitch), Math.sin(pitch)];
    gl.uniformMatrix3fv(this.uniform("turn"), false, [cy, sp * sy, -cp * sy, 0, cp, sp, sy, -sp * cy, cp * cy]);
    gl.uniform3fv(this.uniform("middle"), MIDDLE);
    gl.uniform1f(this.uniform("opacity"), 1);
    gl.uniform1i(this.uniform("flat_"), 0);
    const [width, height] = [canvas.width / 2, canvas.height / rows.length];
    // Depth grows away from the viewer; the panel's frame has z towards the viewer.
    const pixels = Math.min(height / HEIGHT, width / WIDTH);
    gl.uniform3f(this.uniform("scale"), 2 * pixels / width, 2 * pixels / height, -2);
    rows.forEach((row, r) => row.forEach((panel, column) => {
      gl.viewport(column * width, (rows.length - 1 - r) * height, width, height);
      this.mesh("position", panel.positions);
      this.mesh("normal", normals(panel.positions, panel.mesh.faces));
      this.mesh("color", panel.colors);
      this.triangles(panel.mesh.faces);
    }));
  }
}

/** Hands on the image. */
export class SeenHands extends Canvas {
  constructor(canvas) {
    super(canvas, true);
  }

  /** Draws hands as { mesh, seen, colors }: seen is x, y from -1 to 1 and the distance, m, of each vertex. */
  draw(hands) {
    const { gl, canvas } = this;
    // An empty layer above the image costs the browser as much as a full one.
    canvas.hidden = hands.length === 0;
    if (canvas.hidden) return;
    gl.viewport(0, 0, canvas.width, canvas.height);
    gl.clearColor(0, 0, 0, 0);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    gl.uniform1i(this.uniform("flat_"), 1);
    gl.uniform1f(this.uniform("opacity"), 0.72);
    for (const { mesh, seen, colors } of hands) {
      const positions = new Float32Array(seen);
      for (let at = 2; at < positions.length; at += 3) positions[at] = positions[at] / 2 - 0.5;
      const known = vertex => Number.isFinite(seen[3 * vertex]);
      const visible = mesh.faces.every(known) ? mesh.faces : mesh.faces.filter((_, index) => {
        const first = index - index % 3;
        return [0, 1, 2].every(corner => known(mesh.faces[first + corner]));
      });
      this.mesh("position", positions);
      this.mesh("normal", positions);
      this.mesh("color", colors);
      this.triangles(visible);
    }
  }
}
