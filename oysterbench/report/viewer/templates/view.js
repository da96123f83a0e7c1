"use strict";
const data = JSON.parse(document.getElementById("data").textContent);
const sensors = [...document.querySelectorAll("figure.sensor")].map((figure) => ({
  number: +figure.dataset.panel,
  layer: null,
  picture: figure.querySelector("img.panel"),
  over: figure.querySelector("img.over"),
  stamp: figure.querySelector(".stamp"),
  meaning: figure.querySelector(".meaning"),
  classes: figure.querySelector(".classes"),
  opacity: figure.querySelector(".opacity"),
  buttons: [...figure.querySelectorAll(".layers button")],
}));
const cursors = [...document.querySelectorAll(".cursor")];
const moving = [...document.querySelectorAll("path.moving")];
const slider = document.getElementById("time");
const button = document.getElementById("play");
const speed = document.getElementById("speed");
const last = data.seconds.length - 1;
let timer = null;

function show(step) {
  slider.value = step;
  const second = data.seconds[step];
  document.getElementById("clock").textContent = (data.begin + second).toFixed(2) + " s";
  sensors.forEach((sensor) => draw(sensor, step));
  for (const cursor of cursors) {
    const { left, right, span } = cursor.dataset;
    const x = +left + (second / +span) * (+right - +left);
    cursor.setAttribute("x1", x);
    cursor.setAttribute("x2", x);
  }
  moving.forEach((dots, k) => dots.setAttribute("d", data.moving[k][step]));
  const vehicle = document.getElementById("vehicle");
  if (vehicle) {
    const [x, y, heading] = data.path[step];
    vehicle.setAttribute("transform", `translate(${x} ${y}) rotate(${heading})`);
    const [fast, depth, compass] = data.state[step];
    const words = [`${fast.toFixed(2)} m/s`];
    if (depth !== null) words.push(`${depth.toFixed(2)} m deep`, `heading ${compass}°`);
    document.getElementById("state").textContent = words.join(", ");
  }
}

function source(number, step) {
  return "data:image/jpeg;base64," + data.panels[number].frames[step];
}

function stampOf(number, step) {
  // Stamps have more digits than a number of JavaScript.
  const since = data.panels[number].stamps[step];
  return since === null ? "nothing yet" : String(BigInt(data.origin) + BigInt(since));
}

function draw(sensor, step) {
  sensor.picture.src = source(sensor.number, step);
  const shown = sensor.layer === null ? sensor.number : sensor.layer;
  sensor.stamp.textContent = stampOf(shown, step);
  if (sensor.layer !== null) sensor.over.src = source(sensor.layer, step);
}

function choose(sensor, pressed) {
  sensor.buttons.forEach((one) => one.setAttribute("aria-pressed", String(one === pressed)));
  const { layer, meaning } = pressed.dataset;
  sensor.layer = layer === "" ? null : +layer;
  sensor.over.hidden = sensor.opacity.hidden = sensor.layer === null;
  sensor.meaning.textContent = meaning || "";
  if (sensor.classes) {
    sensor.classes.hidden = pressed.textContent !== "class";
    if (!sensor.classes.hidden) sensor.meaning.textContent = "";
  }
  draw(sensor, +slider.value);
}

for (const sensor of sensors) {
  sensor.buttons.forEach((one) => one.addEventListener("click", () => choose(sensor, one)));
  if (sensor.opacity) {
    const range = sensor.opacity.querySelector("input");
    const apply = () => { sensor.over.style.opacity = range.value / 100; };
    range.addEventListener("input", apply);
    apply();
  }
}

function stop() {
  clearInterval(timer);
  timer = null;
  button.textContent = "Play";
}

function play() {
  // At the pace of the sequence, where a step is neither too short to draw nor too long to watch.
  const each = (1000 * data.seconds[last]) / Math.max(last, 1) / +speed.value;
  const pause = Math.min(Math.max(each, 30), 250 / Math.min(+speed.value, 1));
  timer = setInterval(() => show(+slider.value === last ? 0 : +slider.value + 1), pause);
  button.textContent = "Pause";
}

button.addEventListener("click", () => (timer === null ? play() : stop()));
slider.addEventListener("input", () => { stop(); show(+slider.value); });
speed.addEventListener("change", () => { if (timer !== null) { stop(); play(); } });

for (const strip of document.querySelectorAll(".strip")) {
  strip.addEventListener("click", (event) => {
    const { left, right, span } = strip.querySelector(".cursor").dataset;
    const box = strip.getBoundingClientRect();
    const x = ((event.clientX - box.left) / box.width) * strip.viewBox.baseVal.width;
    const second = ((x - left) / (right - left)) * span;
    stop();
    show(Math.min(Math.max(Math.round((second / data.seconds[last]) * last), 0), last));
  });
}

const asked = /^#(\d+)$/.exec(location.hash);
show(asked ? Math.min(+asked[1], last) : 0);
