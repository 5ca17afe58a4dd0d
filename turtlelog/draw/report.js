"use strict";
(() => {
  const config = JSON.parse(document.getElementById("config").textContent);
  const find = (id) => document.getElementById(id);
  const slider = find("time"), play = find("play");
  const dark = matchMedia("(prefers-color-scheme: dark)");
  const shape = [[1, 0], [0.25, 0.55], [-0.75, 0.6], [-0.45, 0], [-0.75, -0.6], [0.25, -0.55]];
  const shown = config.runs.map(() => true);
  const models = new Map(), whole = new Map();
  let now = config.end_s, started = null;
  const model = (id) => models.get(id);

  // The last row at or before a time; times rise.
  function locate(times, at) {
    let low = 0, high = times.length - 1;
    while (low < high) {
      const middle = (low + high + 1) >> 1;
      if (times[middle] <= at) low = middle; else high = middle - 1;
    }
    return low;
  }

  function mix(times, values, at, row) {
    const next = Math.min(row + 1, times.length - 1), span = times[next] - times[row];
    const part = span > 0 ? Math.min(Math.max((at - times[row]) / span, 0), 1) : 0;
    return values[row] + part * (values[next] - values[row]);
  }

  // A value that holds until the next is drawn as a step.
  function makeSteps(t, v) {
    const count = Math.max(2 * t.length - 1, 0);
    const xs = new Float64Array(count), ys = new Float64Array(count);
    for (let row = 0; row < t.length; row++) {
      xs[2 * row] = t[row];
      ys[2 * row] = v[row];
      if (row + 1 < t.length) { xs[2 * row + 1] = t[row + 1]; ys[2 * row + 1] = v[row]; }
    }
    return [xs, ys];
  }

  // What a source holds of all runs is kept here; it draws those that are shown.
  function keepWhole() {
    whole.set(config.ways, {...model(config.ways).data});
    for (const plot of config.plots) {
      const data = {...model(plot.source).data};
      plot.raw = {xs: data.xs, ys: data.ys};
      const drawn = plot.curves.map((curve, row) =>
        curve.holds ? makeSteps(data.xs[row], data.ys[row]) : [data.xs[row], data.ys[row]]);
      data.xs = drawn.map(([xs]) => xs);
      data.ys = drawn.map(([, ys]) => ys);
      whole.set(plot.source, data);
      model(plot.source).data = data;
    }
  }

  function select(id, isKept) {
    const data = whole.get(id), kept = {};
    for (const key of Object.keys(data)) kept[key] = [...data[key]].filter((_, row) => isKept(row));
    model(id).data = kept;
  }

  function drawTurtles() {
    const ways = whole.get(config.ways);
    const trail = {xs: [], ys: [], color: [], alpha: []}, poses = [];
    config.runs.forEach((run, number) => {
      if (!shown[number]) return;
      const [t, x, y, h] = ["t", "x", "y", "h"].map((key) => ways[key][number]);
      const row = locate(t, now);
      const pose = [mix(t, x, now, row), mix(t, y, now, row), mix(t, h, now, row)];
      trail.xs.push([...x.slice(0, row + 1), pose[0]]);
      trail.ys.push([...y.slice(0, row + 1), pose[1]]);
      trail.color.push(ways.way[number]);
      trail.alpha.push(run.ghost ? 0.55 : 1);
      poses.push([run, pose]);
    });
    model(config.trails).data = trail;
    for (const plane of config.planes) {
      const data = {xs: [], ys: [], color: [], alpha: []};
      for (const [run, [x, y, h]] of poses) {
        const cos = Math.cos(h) * plane.size, sin = Math.sin(h) * plane.size;
        data.xs.push(shape.map(([along, left]) => x + along * cos - left * sin));
        data.ys.push(shape.map(([along, left]) => y + along * sin + left * cos));
        data.color.push(run.color);
        data.alpha.push(run.ghost ? 0.2 : 0.75);
      }
      model(plane.turtles).data = data;
    }
  }

  function cell(row, text, name = "td") {
    const made = row.appendChild(document.createElement(name));
    made.textContent = text;
    if (name === "td") made.className = "number";
    return made;
  }

  function writeValues() {
    const table = find("values"), body = document.createElement("tbody");
    const head = document.createElement("thead"), line = head.appendChild(document.createElement("tr"));
    cell(line, "run", "th").scope = "col";
    for (const plot of config.plots) cell(line, plot.title, "th").scope = "col";
    config.runs.forEach((run, number) => {
      if (!shown[number]) return;
      const curves = config.plots.map((plot) => {
        const at = plot.curves.findIndex((one) => one.run === number && !one.aim);
        return at < 0 ? null : {t: plot.raw.xs[at], v: plot.raw.ys[at], holds: plot.curves[at].holds};
      });
      if (!curves.some(Boolean)) return;
      const row = body.appendChild(document.createElement("tr"));
      const ends = Math.max(...curves.filter(Boolean).map((one) => one.t.at(-1)));
      const ended = now > ends + 1e-3 ? ` (ended at ${ends.toFixed(2)} s)` : "";
      cell(row, run.name + ended, "th").scope = "row";
      for (const curve of curves) {
        if (!curve) { cell(row, "-"); continue; }
        const {t, v} = curve, at = locate(t, now);
        const inside = now >= t[0];
        const value = curve.holds ? v[at] : mix(t, v, now, at);
        cell(row, inside && Number.isFinite(value) ? value.toFixed(3).replace(/^-(0\.0*)$/, "$1") : "-");
      }
    });
    const caption = document.createElement("caption");
    caption.textContent = `Values at ${now.toFixed(3)} s; of a run that has ended its last ones`;
    table.replaceChildren(caption, head, body);
  }

  function update() {
    slider.value = Math.round(1000 * now / config.end_s);
    slider.setAttribute("aria-valuetext", `${now.toFixed(2)} seconds`);
    find("now").textContent = `${now.toFixed(2)} s`;
    drawTurtles();
    for (const id of config.cursors) model(id).location = now;
    writeValues();
  }

  function toggle() {
    document.querySelectorAll("[data-run]").forEach((box) => {
      const number = Number(box.dataset.run);
      shown[number] = box.checked;
    });
    select(config.ways, (row) => shown[row]);
    for (const plot of config.plots) select(plot.source, (row) => shown[plot.curves[row].run]);
    const marks = find("marks");
    for (const mark of config.marks)
      model(mark.renderer).visible = (!marks || marks.checked) && shown[mark.run];
    update();
  }

  function stop() {
    started = null;
    play.textContent = "Play";
    play.setAttribute("aria-pressed", "false");
  }

  function step(time) {
    if (started === null) return;
    if (started.at === null) started.at = time;
    // A long run plays in 20 s, a short one in its own time.
    const pace = Math.max(1, config.end_s / 20);
    now = Math.min(started.from + pace * (time - started.at) / 1000, config.end_s);
    update();
    if (now >= config.end_s) stop(); else requestAnimationFrame(step);
  }

  function zoom(factor) {
    const range = model(config.x_range), half = factor * (range.end - range.start) / 2;
    const room = config.room_s, end = config.end_s + room;
    const least = Math.min(Math.max(now - half, -room), Math.max(end - 2 * half, -room));
    range.setv({start: least, end: Math.min(least + 2 * half, end)});
  }

  function paint(is_dark) {
    const ink = is_dark ? "#e8eaed" : "#1c1f23", soft = is_dark ? "#3a4047" : "#dde1e6";
    const ground = is_dark ? "#14171a" : "#ffffff";
    for (const id of config.words)
      model(id).setv({background_fill_color: ground, background_fill_alpha: 0.75});
    for (const id of config.figures) {
      const figure = model(id);
      figure.setv({background_fill_color: ground, border_fill_color: ground,
                   outline_line_color: soft});
      figure.title.text_color = ink;
      for (const axis of [...figure.below, ...figure.left])
        axis.setv({axis_label_text_color: ink, major_label_text_color: ink, axis_line_color: ink,
                   major_tick_line_color: ink, minor_tick_line_color: null,
                   axis_label_text_font_style: "normal"});
      for (const grid of figure.center)
        if ("grid_line_color" in grid) grid.grid_line_color = soft;
    }
  }

  // Paper has no slider: it shows copies of the plots, light, as wide as the page.
  function copyPlots() {
    paint(false);
    for (const place of document.querySelectorAll(".plot")) {
      place.querySelectorAll(":scope > canvas").forEach((old) => old.remove());
      const view = Bokeh.index.find_one_by_id(place.dataset.root);
      if (!view) continue;
      view.canvas_view.paint_engine?.();
      view.paint();
      const image = view.export("png", true).canvas, copy = document.createElement("canvas");
      copy.width = image.width;
      copy.height = image.height;
      copy.getContext("2d").drawImage(image, 0, 0);
      place.append(copy);
    }
    paint(dark.matches);
  }

  function listen() {
    slider.addEventListener("input", () => {
      stop();
      now = config.end_s * Number(slider.value) / 1000;
      update();
    });
    play.addEventListener("click", () => {
      if (started !== null) { stop(); return; }
      if (now >= config.end_s) now = 0;
      started = {from: now, at: null};
      play.textContent = "Pause";
      play.setAttribute("aria-pressed", "true");
      requestAnimationFrame(step);
    });
    find("closer").addEventListener("click", () => zoom(0.5));
    find("wider").addEventListener("click", () => zoom(2));
    find("whole").addEventListener("click", () =>
      model(config.x_range).setv({start: -config.room_s, end: config.end_s + config.room_s}));
    document.querySelectorAll("[data-run], #marks").forEach((box) =>
      box.addEventListener("change", toggle));
    for (const [id, state] of [["all", true], ["none", false]])
      find(id).addEventListener("click", () => {
        document.querySelectorAll("[data-run]").forEach((box) => { box.checked = state; });
        toggle();
      });
    dark.addEventListener("change", () => paint(dark.matches));
    addEventListener("beforeprint", copyPlots);
  }

  // Models by their ids, wherever the config names one.
  function findModels(doc, part) {
    if (typeof part === "string") {
      const found = doc.get_model_by_id(part);
      if (found) models.set(part, found);
    } else if (part && typeof part === "object")
      Object.values(part).forEach((inner) => findModels(doc, inner));
  }

  const draw = () => new Promise((done) => requestAnimationFrame(() => setTimeout(done)));

  // The planes are built first, so that the page can be used; plots follow one by one.
  async function begin() {
    const json = JSON.parse(find("drawing").textContent);
    await Bokeh.embed.embed_items({drawing: json}, []);
    const doc = Bokeh.documents[0], places = Object.entries(config.places);
    findModels(doc, config);
    const later = places.filter(([place]) => place !== "plane" && place !== "goal");
    for (const [, id] of later) doc.remove_root(model(id));
    for (const [place, id] of places) find(place).dataset.root = id;
    keepWhole();
    paint(dark.matches);
    const roots = [...places.filter((one) => !later.includes(one)), ...later];
    await Bokeh.embed.add_document_standalone(doc, document.body, roots.map(([place]) => find(place)));
    listen();
    update();
    document.documentElement.dataset.ready = performance.now().toFixed(0);
    for (const [, id] of later) {
      await draw();
      doc.add_root(model(id));
    }
    await draw();
    document.documentElement.dataset.whole = performance.now().toFixed(0);
  }
  begin();
})();
