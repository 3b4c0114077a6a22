// Draws the total force of both hands over time, with truth, gaps where it is unknown, and familiarity.

const COLORS = ["#1b5fae", "#c2410c"];
const MARGIN = { left: 46, right: 10, top: 8, bottom: 22 };
const STRIP = 8;
/** Height of the band that marks unknown force of a hand. */
const BAND = 18;

/** Returns a round number at or above `value`, and its half. */
function round(value) {
  const power = 10 ** Math.floor(Math.log10(value));
  return [1, 1.5, 2, 3, 4, 5, 8, 10].map(step => step * power).find(step => step >= value * 0.999);
}

export class Chart {
  /** `cursor` is the line of the present, an element above the canvas. */
  constructor(canvas, cursor, onPick) {
    this.canvas = canvas;
    this.cursor = cursor;
    // Many thin lines: without a GPU, the browser draws them much faster into memory.
    this.context = canvas.getContext("2d", { willReadFrequently: true });
    this.range = [0, 1];
    this.drawn = null;
    const pick = event => {
      const box = canvas.getBoundingClientRect();
      const x = (event.clientX - box.left) / box.width * canvas.width;
      const share = (x - MARGIN.left) / (canvas.width - MARGIN.left - MARGIN.right);
      onPick(this.range[0] + Math.max(0, Math.min(1, share)) * (this.range[1] - this.range[0]));
    };
    canvas.addEventListener("pointerdown", pick);
    canvas.addEventListener("pointermove", event => event.buttons && pick(event));
  }

  /**
   * Draws points { stamp, force: [l, r], truth: [l, r] or null, familiarity }, null = unknown, in order of time; `now` is the
   * stamp of the image that is shown. Points of the same `version` are not drawn again.
   */
  draw(points, now, threshold, version) {
    if (this.drawn !== version) this.curves(points, threshold);
    this.drawn = version;
    const { canvas: { width }, range: [first, last] } = this;
    this.cursor.hidden = points.length === 0;
    const x = MARGIN.left + (now - first) / (last - first) * (width - MARGIN.left - MARGIN.right);
    this.cursor.style.left = `${100 * x / width}%`;
  }

  curves(points, threshold) {
    const { context: g, canvas: { width, height } } = this;
    g.clearRect(0, 0, width, height);
    if (points.length === 0) return;
    const first = points[0].stamp, last = Math.max(points[points.length - 1].stamp, first + 0.5);
    this.range = [first, last];
    const values = points.flatMap(point => [...point.force, ...(point.truth ?? [])]).filter(value => value !== null);
    const top = round(Math.max(0.1, ...values));
    const x = stamp => MARGIN.left + (stamp - first) / (last - first) * (width - MARGIN.left - MARGIN.right);
    const y = force => height - MARGIN.bottom - force / top * (height - MARGIN.top - MARGIN.bottom - STRIP);

    g.font = "12px system-ui, 'DejaVu Sans', sans-serif";
    this.gaps(points, x, height);
    g.fillStyle = "#555";
    g.strokeStyle = "#ddd";
    g.lineWidth = 1;
    g.setLineDash([]);
    g.textAlign = "right";
    for (const share of [0, 0.5, 1]) {
      g.beginPath();
      g.moveTo(MARGIN.left, y(share * top));
      g.lineTo(width - MARGIN.right, y(share * top));
      g.stroke();
      g.fillText(`${Number((share * top).toPrecision(3))} N`, MARGIN.left - 5, y(share * top) + 4);
    }
    for (const [share, align] of [[0, "left"], [0.5, "center"], [1, "right"]]) {
      g.textAlign = align;
      g.fillText(`${(share * (last - first)).toFixed(1)} s`, x(first + share * (last - first)), height - 5);
    }
    for (const side of [0, 1]) {
      this.curve(points, point => point.truth?.[side] ?? null, x, y, COLORS[side], 1.2, [4, 3]);
      this.curve(points, point => point.force[side], x, y, COLORS[side], 2, []);
    }
    this.strip(points, x, threshold);
  }

  curve(points, value, x, y, color, lineWidth, dash) {
    const g = this.context;
    g.strokeStyle = color;
    g.lineWidth = lineWidth;
    g.setLineDash(dash);
    g.beginPath();
    let pen = false;
    for (const point of points) {
      const force = value(point);
      // Unknown force interrupts the curve.
      if (force === null) pen = false;
      else {
        g[pen ? "lineTo" : "moveTo"](x(point.stamp), y(force));
        pen = true;
      }
    }
    g.stroke();
  }

  /** Marks the time in which the force of a hand is unknown, in a band of its own for each hand. */
  gaps(points, x, height) {
    const g = this.context;
    for (const side of [0, 1]) {
      const top = height - MARGIN.bottom - BAND * (2 - side);
      let label = null;
      points.forEach((point, index) => {
        if (point.force[side] !== null) return;
        label ??= x(point.stamp);
        g.fillStyle = "#e2e4e8";
        g.fillRect(x(point.stamp), top, this.length(points, index, x), BAND - 2);
      });
      if (label === null) continue;
      g.fillStyle = "#555";
      g.textAlign = "left";
      g.fillText(`${["left", "right"][side]} hand unknown`, label + 6, top + BAND - 6);
    }
  }

  strip(points, x, threshold) {
    const g = this.context;
    points.forEach((point, index) => {
      if (point.familiarity === null || point.familiarity === undefined) return;
      g.fillStyle = threshold !== null && point.familiarity < threshold ? "#d55e00" : "#9ecae8";
      g.fillRect(x(point.stamp), MARGIN.top - 4, this.length(points, index, x), STRIP - 2);
    });
  }

  /** Returns the width of a point's time: up to the next point, or as long as the one before. */
  length(points, index, x) {
    const from = Math.max(0, Math.min(index, points.length - 2));
    return points.length > 1 ? Math.ceil(x(points[from + 1].stamp) - x(points[from].stamp)) + 0.5 : 2;
  }
}
