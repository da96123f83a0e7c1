"use strict";
// Zoom and pan of the plots, and curves that a click on their name hides. Without it the page reads as it is.

const SVG = "http://www.w3.org/2000/svg";
const numbers = (text) => text.split(" ").map(Number);

function niceTicks(low, high, count) {
  const rough = (high - low) / count;
  const power = 10 ** Math.floor(Math.log10(rough));
  const step = [1, 2, 5, 10].map((factor) => factor * power).find((size) => size >= rough);
  const decimals = Math.max(0, -Math.floor(Math.log10(step) + 1e-9));
  const ticks = [];
  for (let k = Math.ceil(low / step - 1e-9); k * step <= high + 1e-9 * step; k += 1) {
    ticks.push([k * step, (k * step + 0).toFixed(decimals).replace(/^-(0(\.0+)?)$/, "$1").replace("-", "\u2212")]);
  }
  return ticks;
}

function element(name, attributes, text) {
  const made = document.createElementNS(SVG, name);
  for (const [key, value] of Object.entries(attributes)) made.setAttribute(key, value);
  if (text !== undefined) made.textContent = text;
  return made;
}

class Plot {
  constructor(svg) {
    this.svg = svg;
    [this.left, this.top, this.width, this.height] = numbers(svg.dataset.box);
    this.log = "log" in svg.dataset;
    this.home = { x: numbers(svg.dataset.x), y: numbers(svg.dataset.y) };
    if (this.log) this.home.y = this.home.y.map(Math.log10);
    this.equal = svg.dataset.zoom === "equal";
    this.curves = svg.querySelector(".curves");
    this.marks = [...svg.querySelectorAll(".marks > *")];
    this.ticks = svg.querySelector(".ticks");
    this.drawn = this.ticks.innerHTML;
    this.pointers = new Map();
    svg.classList.add("live");
    svg.addEventListener("wheel", (event) => this.wheel(event), { passive: false });
    svg.setAttribute("tabindex", "0");
    svg.addEventListener("keydown", (event) => this.key(event));
    svg.addEventListener("pointerleave", () => { this.awake = false; });
    svg.addEventListener("dblclick", () => this.reset());
    svg.addEventListener("pointerdown", (event) => this.press(event));
    svg.addEventListener("pointermove", (event) => this.drag(event));
    for (const end of ["pointerup", "pointercancel"]) svg.addEventListener(end, (event) => this.release(event));
    this.reset();
  }

  reset() {
    this.scale = { x: 1, y: 1 };
    this.shift = { x: 0, y: 0 };
    this.draw();
  }

  // From the screen to the drawing's units, within the frame.
  place(event) {
    const box = this.svg.getBoundingClientRect();
    const unit = this.svg.viewBox.baseVal.width / box.width;
    return { x: (event.clientX - box.left) * unit, y: (event.clientY - box.top) * unit };
  }

  zoom(factor, at) {
    for (const axis of ["x", "y"]) {
      const scale = Math.min(Math.max(this.scale[axis] * factor, 1), 400);
      this.shift[axis] = at[axis] - ((at[axis] - this.shift[axis]) * scale) / this.scale[axis];
      this.scale[axis] = scale;
    }
    this.draw();
  }

  move(dx, dy) {
    this.shift.x += dx;
    this.shift.y += dy;
    this.draw();
  }

  wheel(event) {
    if (!event.ctrlKey && !this.awake) return; // the page scrolls on, until the plot is clicked
    const factor = Math.exp(-event.deltaY * (event.deltaMode === 1 ? 0.05 : event.ctrlKey ? 0.01 : 0.002));
    if (factor < 1 && this.scale.x === 1) return; // nothing to zoom out of: the page scrolls on
    event.preventDefault();
    this.zoom(factor, this.place(event));
  }

  key(event) {
    const middle = { x: this.left + this.width / 2, y: this.top + this.height / 2 };
    const steps = {
      "+": () => this.zoom(1.5, middle),
      "-": () => this.zoom(1 / 1.5, middle),
      0: () => this.reset(),
      ArrowLeft: () => this.move(40, 0),
      ArrowRight: () => this.move(-40, 0),
      ArrowUp: () => this.move(0, 40),
      ArrowDown: () => this.move(0, -40),
    };
    if (!(event.key in steps) || event.ctrlKey || event.metaKey) return;
    event.preventDefault();
    steps[event.key]();
  }

  press(event) {
    this.awake = true;
    this.pointers.set(event.pointerId, this.place(event));
    if (event.pointerType === "mouse" || this.scale.x > 1) this.svg.setPointerCapture(event.pointerId);
  }

  drag(event) {
    const before = this.pointers.get(event.pointerId);
    if (!before) return;
    const now = this.place(event);
    const other = [...this.pointers].find(([id]) => id !== event.pointerId);
    if (other) {
      const [, fixed] = other;
      const span = (a) => Math.hypot(a.x - fixed.x, a.y - fixed.y) || 1;
      this.zoom(span(now) / span(before), fixed);
    } else if (event.pointerType === "mouse" || this.scale.x > 1) {
      this.move(now.x - before.x, now.y - before.y);
    }
    this.pointers.set(event.pointerId, now);
  }

  release(event) {
    this.pointers.delete(event.pointerId);
  }

  // Shown values of an axis, after zoom and shift.
  shown(axis) {
    const [low, high] = this.home[axis];
    const [begin, size] = axis === "x" ? [this.left, this.width] : [this.top, this.height];
    const at = (pixel) => (pixel - this.shift[axis]) / this.scale[axis];
    const share = (pixel) => (at(pixel) - begin) / size;
    const value = (part) => low + (axis === "x" ? part : 1 - part) * (high - low);
    const ends = [value(share(begin)), value(share(begin + size))];
    return axis === "x" ? ends : ends.reverse();
  }

  draw() {
    const { scale, shift } = this;
    for (const [axis, begin, size] of [["x", this.left, this.width], ["y", this.top, this.height]]) {
      // The picture may be moved, never out of its frame.
      const low = begin + size - (begin + size) * scale[axis];
      shift[axis] = Math.min(Math.max(shift[axis], low), begin - begin * scale[axis]);
    }
    const moved = scale.x > 1;
    this.svg.classList.toggle("zooming", moved);
    this.curves.setAttribute("transform", `translate(${shift.x} ${shift.y}) scale(${scale.x} ${scale.y})`);
    for (const mark of this.marks) {
      const x = +(mark.getAttribute("cx") ?? +mark.getAttribute("x") + mark.getAttribute("width") / 2);
      const y = +(mark.getAttribute("cy") ?? +mark.getAttribute("y") + mark.getAttribute("height") / 2);
      mark.setAttribute("transform", `translate(${x * scale.x + shift.x - x} ${y * scale.y + shift.y - y})`);
    }
    if (!moved) {
      this.ticks.innerHTML = this.drawn;
      return;
    }
    this.ticks.replaceChildren();
    const right = this.left + this.width, bottom = this.top + this.height;
    const [xLow, xHigh] = this.shown("x");
    for (const [value, text] of niceTicks(xLow, xHigh, 6)) {
      const x = this.left + ((value - xLow) / (xHigh - xLow)) * this.width;
      this.ticks.append(
        element("path", { class: "grid", d: `M${x} ${this.top}V${bottom}` }),
        element("text", { class: "tick", x, y: bottom + 17, "text-anchor": "middle" }, text),
      );
    }
    const [yLow, yHigh] = this.shown("y");
    for (const [value, text] of this.log ? this.powers(yLow, yHigh) : niceTicks(yLow, yHigh, this.height / 40)) {
      const y = bottom - ((value - yLow) / (yHigh - yLow)) * this.height;
      this.ticks.append(
        element("path", { class: "grid", d: `M${this.left} ${y}H${right}` }),
        element("text", { class: "tick", x: this.left - 7, y: y + 4.5, "text-anchor": "end" }, text),
      );
    }
  }

  powers(low, high) {
    const wide = high - low > 1.5;
    const ticks = [];
    for (let power = Math.floor(low); power <= Math.ceil(high); power += 1) {
      for (const factor of wide ? [1] : [1, 2, 5]) {
        const value = power + Math.log10(factor);
        if (value >= low && value <= high) ticks.push([value, String(+(10 ** value).toPrecision(2))]);
      }
    }
    return ticks;
  }
}

for (const svg of document.querySelectorAll(".plot[data-zoom]")) new Plot(svg);
for (const hint of document.querySelectorAll(".zoomed")) hint.hidden = false;

for (const item of document.querySelectorAll(".legend li[data-label]")) {
  const section = item.closest("section");
  const button = document.createElement("button");
  button.type = "button";
  button.setAttribute("aria-pressed", "true");
  button.append(...item.childNodes);
  item.append(button);
  button.addEventListener("click", () => {
    const on = button.getAttribute("aria-pressed") === "false";
    button.setAttribute("aria-pressed", String(on));
    for (const curve of section.querySelectorAll(".plot [data-label]")) {
      if (curve.dataset.label === item.dataset.label) curve.classList.toggle("off", !on);
    }
  });
}
