"use strict";
// Residuals of one slew and channel on a canvas: choose, zoom, read. Names are only ever set as
// text. Without this script the page shows its pictures instead.
(() => {
  const MARGIN = { left: 46, right: 10, top: 10, bottom: 34 };
  const NOT_MEASURED = -32768;
  const CLOSEST = 4; // rows in view at least

  const bytes = (text) => Uint8Array.from(atob(text), (c) => c.charCodeAt(0)).buffer;

  function unpack(part, step) {
    const view = (text, size, read) => {
      const data = new DataView(bytes(text));
      return Array.from({ length: data.byteLength / size }, (_, i) => read(data, i * size));
    };
    return {
      time: view(part.time, 4, (data, at) => data.getFloat32(at, true)),
      residual: part.residual.map((text) => view(text, 2, (data, at) => {
        const value = data.getInt16(at, true);
        return value === NOT_MEASURED ? NaN : value * step;
      })),
      rows: part.rows,
    };
  }

  function ticks(low, high, wanted) {
    const rough = (high - low) / wanted;
    const power = 10 ** Math.floor(Math.log10(rough));
    const step = power * [1, 2, 5, 10].find((m) => m * power >= rough);
    const decimals = Math.max(0, -Math.floor(Math.log10(step) + 1e-9));
    const found = [];
    for (let k = Math.ceil(low / step); k * step <= high; k += 1) {
      found.push([k * step, (k * step).toFixed(decimals).replace("-", "−")]);
    }
    return found;
  }

  function signed(value) {
    return Number.isNaN(value) ? "not measured"
      : `${value < 0 ? "−" : "+"}${Math.abs(value).toFixed(2)} σ`;
  }

  function nearest(times, t) {
    let low = 0;
    let high = times.length - 1;
    while (high - low > 1) {
      const middle = (low + high) >> 1;
      if (times[middle] < t) low = middle; else high = middle;
    }
    return t - times[low] < times[high] - t ? low : high;
  }

  function explore(root) {
    const data = JSON.parse(root.querySelector(".data").textContent);
    const part = (selector) => root.querySelector(selector);
    const [channel, slew, canvas] = ["[name=channel]", "[name=slew]", "canvas"].map(part);
    const [legend, reading, shown] = [".components", ".reading", ".shown"].map(part);
    const pen = canvas.getContext("2d");
    let series = null; // of the slew and channel chosen
    let view = [0, 1]; // [s]
    let hidden = new Set(); // components
    let cursor = null; // index of a row
    let dragged = null; // [from, to] in pixels
    let digits = 2; // of times in print

    const width = () => canvas.clientWidth - MARGIN.left - MARGIN.right;
    const height = () => canvas.clientHeight - MARGIN.top - MARGIN.bottom;
    const x = (t) => MARGIN.left + (width() * (t - view[0])) / (view[1] - view[0]);
    const timeAt = (px) => view[0] + ((px - MARGIN.left) / width()) * (view[1] - view[0]);
    const inside = (px) => Math.min(Math.max(px, MARGIN.left), MARGIN.left + width());
    const color = (name) => getComputedStyle(root).getPropertyValue(name).trim();
    const seriesColor = (i) => color(`--series-${(i % 6) + 1}`);

    function span() {
      const t = series.time;
      const [low, high] = t.length ? [t[0], t[t.length - 1]] : [0, 1];
      return high > low ? [low, high] : [low - 0.5, low + 0.5];
    }

    function choose() {
      const chosen = data.channels[channel.value];
      const packed = chosen.slews[slew.value];
      series = unpack(packed, chosen.step);
      view = span();
      cursor = null;
      const kept = series.time.length;
      const step = (view[1] - view[0]) / Math.max(1, packed.rows);
      digits = Math.min(6, Math.max(2, Math.ceil(1 - Math.log10(step))));
      shown.textContent = kept === packed.rows
        ? `All ${kept} rows of this slew are shown.`
        : `${kept} of ${packed.rows} rows of this slew are shown: evenly spaced ones, and of each `
          + "stretch those with the lowest and the highest residual.";
      draw();
    }

    function chooseChannel() {
      hidden = new Set();
      const chosen = data.channels[channel.value];
      legend.replaceChildren(...chosen.components.map(toggle));
      const at = slew.value;
      slew.replaceChildren(...data.slews.map((name, s) => {
        const square = chosen.slews[s].mean_square;
        return new Option(square === null ? `${name} (no data)` : `${name} (χ²/n ${square})`, s);
      }));
      slew.value = at === "" ? data.start[1] : at;
      choose();
    }

    function toggle(name, i) {
      const label = document.createElement("label");
      const box = document.createElement("input");
      const mark = document.createElement("span");
      box.type = "checkbox";
      box.checked = true;
      box.addEventListener("change", () => {
        if (box.checked) hidden.delete(i); else hidden.add(i);
        draw();
      });
      mark.className = `mark series-${(i % 6) + 1}`;
      label.append(box, mark, name);
      return label;
    }

    function zoom(low, high) {
      const [first, last] = span();
      const least = (CLOSEST * (last - first)) / Math.max(CLOSEST, series.time.length - 1);
      const size = Math.min(Math.max(high - low, least), last - first);
      const start = Math.min(Math.max((low + high - size) / 2, first), last - size);
      view = [start, start + size];
      draw();
    }

    const scaled = (factor) => {
      const middle = cursor === null ? (view[0] + view[1]) / 2 : series.time[cursor];
      const place = Math.min(Math.max((middle - view[0]) / (view[1] - view[0]), 0), 1);
      const size = (view[1] - view[0]) * factor;
      zoom(middle - place * size, middle + (1 - place) * size);
    };
    const shifted = (share) => {
      const by = share * (view[1] - view[0]);
      zoom(view[0] + by, view[1] + by);
    };

    function limit() {
      let largest = 4.2;
      series.residual.forEach((values, i) => {
        if (hidden.has(i)) return;
        values.forEach((value, k) => {
          const t = series.time[k];
          if (t >= view[0] && t <= view[1] && Math.abs(value) > largest) largest = Math.abs(value);
        });
      });
      return 1.06 * largest;
    }

    function line(x0, y0, x1, y1) {
      pen.beginPath();
      pen.moveTo(x0, y0);
      pen.lineTo(x1, y1);
      pen.stroke();
    }

    function frame(y, top) {
      const right = MARGIN.left + width();
      const bottom = MARGIN.top + height();
      pen.font = "12px system-ui, sans-serif";
      pen.fillStyle = color("--muted");
      pen.strokeStyle = color("--line");
      pen.textAlign = "right";
      pen.textBaseline = "middle";
      for (const [value, text] of ticks(-top, top, 6)) {
        line(MARGIN.left - 4, y(value), MARGIN.left, y(value));
        pen.fillText(text, MARGIN.left - 7, y(value));
      }
      pen.textAlign = "center";
      pen.textBaseline = "top";
      for (const [value, text] of ticks(view[0], view[1], Math.max(3, width() / 110))) {
        line(x(value), bottom, x(value), bottom + 4);
        pen.fillText(text, x(value), bottom + 6);
      }
      pen.fillText("time in slew [s]", MARGIN.left + width() / 2, bottom + 20);
      line(MARGIN.left, y(0), right, y(0));
      pen.strokeStyle = color("--muted");
      pen.setLineDash([4, 4]);
      for (const sigma of [1, 2, 3]) {
        pen.globalAlpha = 0.25 * sigma;
        line(MARGIN.left, y(sigma), right, y(sigma));
        line(MARGIN.left, y(-sigma), right, y(-sigma));
      }
      pen.globalAlpha = 1;
      pen.setLineDash([]);
    }

    function draw() {
      const ratio = window.devicePixelRatio || 1;
      canvas.width = Math.round(canvas.clientWidth * ratio);
      canvas.height = Math.round(canvas.clientHeight * ratio);
      pen.setTransform(ratio, 0, 0, ratio, 0, 0);
      const top = limit();
      const y = (value) => MARGIN.top + (height() * (top - value)) / (2 * top);
      frame(y, top);
      if (!series.time.length) pen.fillText("no data", MARGIN.left + width() / 2, y(0) - 20);
      const radius = series.time.length > 4 * width() ? 1.2 : 1.9;
      series.residual.forEach((values, i) => {
        if (hidden.has(i)) return;
        pen.fillStyle = seriesColor(i);
        pen.globalAlpha = 0.75;
        values.forEach((value, k) => {
          const t = series.time[k];
          if (Number.isNaN(value) || t < view[0] || t > view[1]) return;
          pen.beginPath();
          pen.arc(x(t), y(value), k === cursor ? 4 : radius, 0, 7);
          pen.fill();
        });
      });
      pen.globalAlpha = 1;
      if (cursor !== null) {
        pen.strokeStyle = color("--muted");
        line(x(series.time[cursor]), MARGIN.top, x(series.time[cursor]), MARGIN.top + height());
      }
      if (dragged) {
        pen.fillStyle = color("--link");
        pen.globalAlpha = 0.15;
        pen.fillRect(dragged[0], MARGIN.top, dragged[1] - dragged[0], height());
        pen.globalAlpha = 1;
      }
      read();
    }

    function read() {
      if (cursor === null) {
        reading.textContent = `${view.map((t) => t.toFixed(digits)).join(" to ")} s`;
        return;
      }
      const names = data.channels[channel.value].components;
      const said = names.map((name, i) => `${name} ${signed(series.residual[i][cursor])}`);
      const at = `t = ${series.time[cursor].toFixed(digits)} s`;
      reading.textContent = [at, ...said.filter((_, i) => !hidden.has(i))].join("   ");
    }

    function point(px) {
      const index = series.time.length ? nearest(series.time, timeAt(inside(px))) : null;
      if (index === cursor && !dragged) return;
      cursor = index;
      draw();
    }

    const moves = {
      ArrowLeft: () => shifted(-0.2),
      ArrowRight: () => shifted(0.2),
      "+": () => scaled(0.5),
      "-": () => scaled(2),
      0: () => zoom(...span()),
    };
    canvas.addEventListener("keydown", (event) => {
      if (!moves[event.key] || event.ctrlKey || event.metaKey || event.altKey) return;
      event.preventDefault();
      moves[event.key]();
    });
    canvas.addEventListener("pointerdown", (event) => {
      canvas.setPointerCapture(event.pointerId);
      dragged = [inside(event.offsetX), inside(event.offsetX)];
      point(event.offsetX);
    });
    canvas.addEventListener("pointermove", (event) => {
      if (dragged) dragged[1] = inside(event.offsetX);
      point(event.offsetX);
    });
    canvas.addEventListener("pointerup", () => {
      const [from, to] = dragged || [0, 0];
      dragged = null;
      if (Math.abs(to - from) > 6) {
        zoom(Math.min(timeAt(from), timeAt(to)), Math.max(timeAt(from), timeAt(to)));
      } else {
        draw();
      }
    });
    canvas.addEventListener("pointercancel", () => { dragged = null; draw(); });
    canvas.addEventListener("pointerleave", () => { if (!dragged) { cursor = null; draw(); } });
    canvas.addEventListener("dblclick", () => zoom(...span()));
    part("[name=closer]").addEventListener("click", () => scaled(0.5));
    part("[name=wider]").addEventListener("click", () => scaled(2));
    part("[name=whole]").addEventListener("click", () => zoom(...span()));
    channel.addEventListener("change", chooseChannel);
    slew.addEventListener("change", choose);

    channel.replaceChildren(...data.channels.map((c, i) => new Option(c.name, i)));
    channel.value = data.start[0];
    root.hidden = false;
    chooseChannel();
    new ResizeObserver(draw).observe(canvas);
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", draw);
  }

  document.querySelectorAll(".explorer").forEach(explore);
  // Last: where the script fails, the pictures stay.
  document.documentElement.classList.add("scripted");
})();
