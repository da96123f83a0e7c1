"use strict";
const data = JSON.parse(document.getElementById("data").textContent);
const pictures = [...document.querySelectorAll("img.panel")];
const cursors = [...document.querySelectorAll(".cursor")];
const moving = [...document.querySelectorAll("path.moving")];
const slider = document.getElementById("time");
const button = document.getElementById("play");
const last = data.seconds.length - 1;
let timer = null;

function show(step) {
  slider.value = step;
  const second = data.seconds[step];
  document.getElementById("clock").textContent = (data.begin + second).toFixed(2) + " s";
  pictures.forEach((picture, k) => { picture.src = "data:image/jpeg;base64," + data.panels[k].frames[step]; });
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
  }
}

function stop() {
  clearInterval(timer);
  timer = null;
  button.textContent = "Play";
}

function play() {
  // At the pace of the sequence, where a step is neither too short to draw nor too long to watch.
  const pause = Math.min(Math.max((1000 * data.seconds[last]) / Math.max(last, 1), 50), 250);
  timer = setInterval(() => show(+slider.value === last ? 0 : +slider.value + 1), pause);
  button.textContent = "Pause";
}

button.addEventListener("click", () => (timer === null ? play() : stop()));
slider.addEventListener("input", () => { stop(); show(+slider.value); });

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
