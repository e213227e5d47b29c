// A whole run that zooms: measured and predicted above, measured less predicted beneath.
for (const figure of document.querySelectorAll("figure.run")) {
  const about = JSON.parse(figure.dataset.about), steps = about.steps;
  const bytes = Uint8Array.from(atob(figure.dataset.numbers), (c) => c.charCodeAt(0));
  const levels = new Int16Array(bytes.buffer);
  const [motion, missed] = figure.querySelectorAll("canvas");
  const select = figure.querySelector("select"), where = figure.querySelector(".where i");
  const reading = figure.querySelector(".reading");
  const unit = about.step === null ? "steps" : "s", step = about.step ?? 1;
  let first = 0, last = steps, drag = null, hover = null;

  // The series of the chosen signal: measured, then its errors; NaN where a simulation failed.
  const chosen = () => {
    const at = +select.value, signal = about.signals[at], count = signal.series.length;
    return signal.series.map(([base, scale], k) => (i) => {
      const level = levels[(at * count + k) * steps + i];
      return level === -32768 ? NaN : base + scale * level;
    });
  };
  const color = (name) => getComputedStyle(figure).getPropertyValue("--" + name).trim();
  const short = (x) => (x === 0 || (Math.abs(x) >= 1e-3 && Math.abs(x) < 1e5)
    ? String(+x.toPrecision(4)) : x.toExponential(2));

  const ticks = (low, high, most) => {
    const raw = (high - low) / most, power = 10 ** Math.floor(Math.log10(raw));
    const each = power * ([1, 2, 5, 10].find((n) => n * power >= raw) ?? 10), found = [];
    for (let k = Math.ceil(low / each); k * each <= high; k++) {
      found.push(+(k * each).toPrecision(12));
    }
    return found;
  };

  // Draws lines, each as {at: i -> value, color, dash, dots}, with axes; the ends of the values are
  // theirs.
  const draw = (canvas, lines, title, withTime) => {
    const ratio = devicePixelRatio || 1, width = canvas.clientWidth, height = canvas.clientHeight;
    canvas.width = width * ratio;
    canvas.height = height * ratio;
    const pen = canvas.getContext("2d");
    pen.scale(ratio, ratio);
    pen.font = "12px " + getComputedStyle(figure).fontFamily;
    const left = 58, right = width - 8, top = 20, bottom = height - (withTime ? 22 : 6);
    let low = Infinity, high = -Infinity;
    for (const line of lines) {
      for (let i = first; i < last; i++) {
        const value = line.at(i);
        if (value < low) low = value;
        if (value > high) high = value;
      }
    }
    if (!(high >= low)) [low, high] = [-1, 1];
    const room = (high - low) * 0.06 || Math.abs(high) * 0.1 || 1;
    low -= room;
    high += room;
    const x = (i) => left + ((i - first + 0.5) / (last - first)) * (right - left);
    const y = (value) => bottom - ((value - low) / (high - low)) * (bottom - top);
    pen.fillStyle = color("light");
    pen.globalAlpha = 0.35;
    for (const [from, to] of about.heldOut) {
      const begin = Math.max(from, first), end = Math.min(to, last);
      if (end > begin) {
        pen.fillRect(x(begin - 0.5), top, x(end - 0.5) - x(begin - 0.5), bottom - top);
      }
    }
    pen.globalAlpha = 1;
    pen.strokeStyle = color("line");
    pen.fillStyle = color("grey");
    pen.lineWidth = 1;
    pen.textBaseline = "middle";
    pen.textAlign = "right";
    for (const value of ticks(low, high, Math.max(4, (bottom - top) / 45))) {
      pen.beginPath();
      pen.moveTo(left, y(value));
      pen.lineTo(right, y(value));
      pen.stroke();
      pen.fillText(short(value), left - 6, y(value));
    }
    if (withTime) {
      pen.textBaseline = "top";
      pen.textAlign = "center";
      for (const time of ticks((first + 1) * step, last * step, Math.max(2, width / 90))) {
        const place = x(time / step - 1);
        if (place < left + 8 || place > right - 30) continue;
        pen.fillText(short(time), place, bottom + 6);
      }
      pen.textAlign = "right";
      pen.fillText(unit, right, bottom + 6);
    }
    pen.textAlign = "left";
    pen.textBaseline = "top";
    pen.fillStyle = color("ink");
    pen.fillText(title, left, 2);
    pen.save();
    pen.beginPath();
    pen.rect(left, top - 2, right - left, bottom - top + 4);
    pen.clip();
    const each = (last - first) / (right - left);  // steps in a pixel
    for (const line of lines) {
      pen.strokeStyle = pen.fillStyle = color(line.color);
      pen.lineWidth = line.dots ? 1 : 1.6;
      pen.setLineDash(line.dash && each < 1 ? [6, 4] : []);
      if (line.dots && each < 0.35) {
        for (let i = first; i < last; i++) {
          pen.beginPath();
          pen.arc(x(i), y(line.at(i)), 1.9, 0, 7);
          pen.fill();
        }
        continue;
      }
      pen.beginPath();
      let up = false;
      for (let i = Math.max(0, first - 1); i < Math.min(steps, last + 1); i++) {
        const value = line.at(i);
        if (!line.dots && i % about.length === 0) up = false;
        if (isNaN(value)) { up = false; continue; }
        up ? pen.lineTo(x(i), y(value)) : pen.moveTo(x(i), y(value));
        up = true;
      }
      pen.stroke();
    }
    pen.setLineDash([]);
    if (drag && drag.to !== null) {
      pen.fillStyle = color("after");
      pen.globalAlpha = 0.2;
      pen.fillRect(Math.min(drag.from, drag.to), top, Math.abs(drag.to - drag.from), bottom - top);
      pen.globalAlpha = 1;
    } else if (hover !== null) {
      pen.strokeStyle = color("grey");
      pen.beginPath();
      pen.moveTo(x(hover), top);
      pen.lineTo(x(hover), bottom);
      pen.stroke();
    }
    pen.restore();
  };

  const show = () => {
    const series = chosen(), signal = about.signals[+select.value], both = series.length > 2;
    const titled = (text) => text + (signal.unit ? " [" + signal.unit + "]" : "");
    const kinds = both ? [["before", true], ["after", false]] : [["after", false]];
    const errors = kinds.map(([name, dash], k) => ({ at: series[k + 1], color: name, dash }));
    const lines = errors.map((one) => ({ ...one, at: (i) => series[0](i) - one.at(i) }));
    const measured = { at: series[0], color: "ink", dots: true };
    draw(motion, [...lines, measured], titled(signal.name), false);
    draw(missed, errors, titled("measured less predicted"), true);
    where.style.left = (100 * first) / steps + "%";
    where.style.width = Math.max(1, (100 * (last - first)) / steps) + "%";
    if (hover === null) {
      reading.textContent = `${short(first * step)} to ${short(last * step)} ${unit}`;
    } else {
      const time = short((hover + 1) * step);
      const parts = [`at ${time} ${unit}: measured ${short(series[0](hover))}`];
      kinds.forEach(([name], k) => {
        const value = series[0](hover) - series[k + 1](hover);
        parts.push(`${both ? name : "predicted"} ${isNaN(value) ? "failed" : short(value)}`);
      });
      reading.textContent = parts.join(", ");
    }
  };
  const look = (from, to) => {
    const least = Math.min(steps, 10);
    const size = Math.min(steps, Math.max(least, Math.round(to - from)));
    first = Math.max(0, Math.min(steps - size, Math.round((from + to - size) / 2)));
    last = first + size;
    show();
  };
  const acts = {
    in: () => look(first + (last - first) / 4, last - (last - first) / 4),
    out: () => look(first - (last - first) / 2, last + (last - first) / 2),
    back: () => look(first - (last - first) / 2, last - (last - first) / 2),
    on: () => look(first + (last - first) / 2, last + (last - first) / 2),
    all: () => look(0, steps),
  };
  for (const button of figure.querySelectorAll("[data-do]")) {
    button.addEventListener("click", acts[button.dataset.do]);
  }
  const keys = { "+": "in", "-": "out", ArrowLeft: "back", ArrowRight: "on", 0: "all" };
  motion.addEventListener("keydown", (event) => {
    if (!(event.key in keys)) return;
    event.preventDefault();
    acts[keys[event.key]]();
  });
  select.addEventListener("change", show);

  const at = (place, canvas) => first + ((place - 58) / (canvas.clientWidth - 66)) * (last - first);
  for (const canvas of [motion, missed]) {
    const place = (event) => event.clientX - canvas.getBoundingClientRect().left;
    canvas.addEventListener("pointerdown", (event) => {
      drag = { from: place(event), to: null };
      canvas.setPointerCapture(event.pointerId);
    });
    canvas.addEventListener("pointermove", (event) => {
      if (drag && Math.abs(place(event) - drag.from) > 6) drag.to = place(event);
      hover = Math.min(last - 1, Math.max(first, Math.floor(at(place(event), canvas))));
      show();
    });
    canvas.addEventListener("pointerup", () => {
      const done = drag;
      drag = null;
      if (done && done.to !== null) {
        const ends = [at(done.from, canvas), at(done.to, canvas)].sort((a, b) => a - b);
        hover = null;
        look(...ends);
      } else show();
    });
    canvas.addEventListener("pointercancel", () => { drag = null; show(); });
    canvas.addEventListener("pointerleave", () => { if (!drag) { hover = null; show(); } });
    canvas.addEventListener("dblclick", acts.all);
  }
  new ResizeObserver(show).observe(figure);
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", show);
}
