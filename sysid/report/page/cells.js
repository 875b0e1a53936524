document.documentElement.classList.add("scripted");
for (const root of document.querySelectorAll("[data-cells]")) {
  const content = JSON.parse(root.querySelector('script[type="application/json"]').textContent);
  const find = (what, name) => root.querySelector("[data-" + what + '="' + name + '"]');
  const canvas = root.querySelector("canvas"), pen = canvas.getContext("2d");
  const sliders = { x: find("do", "x"), y: find("do", "y") };
  const lost = content.colours.length - 1;
  const place = { left: 52, right: 8, top: 8, bottom: 46 };
  let chart, pinned, shown, box;

  const rgb = (colour) => [1, 3, 5].map((at) => parseInt(colour.slice(at, at + 2), 16));
  const classes = content.colours.map(rgb);
  const cell = (at) => at.y * chart.x.texts.length + at.x;
  const text = (what, value) => { find("is", what).textContent = value; };
  const thousandths = (value, unit) => (value === null ? "–" : (value / 1000).toFixed(3) + " " + unit);

  const said = (axis, k) => (chart[axis].texts[k] + " " + chart[axis].unit).trim();
  const label = (axis) => chart[axis].name + (chart[axis].unit ? " [" + chart[axis].unit + "]" : "");

  function choose(number) {
    const before = chart && { x: chart.x.texts[pinned.x], y: chart.y.texts[pinned.y] };
    chart = content.charts[number];
    pinned = {};
    for (const axis of ["x", "y"]) {
      const texts = chart[axis].texts, same = before ? texts.indexOf(before[axis]) : -1;
      pinned[axis] = same < 0 ? Math.floor(texts.length / 2) : same;
      sliders[axis].max = String(texts.length - 1);
      text(axis + "-label", chart[axis].name);
    }
    legend();
    show(pinned);
  }

  function legend() {
    const used = new Set(chart.outcome.join(""));
    find("is", "legend").replaceChildren(...content.words.map((words, code) => {
      const item = document.createElement("li");
      item.hidden = !used.has(String(code));
      item.append(patch(code), words);
      return item;
    }));
  }

  function patch(code) {
    const mark = document.createElement("span");
    mark.className = "patch";
    mark.style.background = content.colours[code];
    return mark;
  }

  function show(at) {
    shown = { x: at.x, y: at.y };
    const k = cell(shown);
    for (const axis of ["x", "y"]) {
      const value = said(axis, shown[axis]);
      sliders[axis].value = String(shown[axis]);
      sliders[axis].setAttribute("aria-valuetext", value);
      text(axis, value);
    }
    const counts = content.words.map((_, code) => chart.outcome.filter((row) => Number(row[k]) === code).length);
    const most = counts.indexOf(Math.max(...counts.slice(0, lost))), all = chart.rows.length;
    let words = counts[lost] === all ? content.words[lost] : content.words[most];
    if (all > 1) { words += " (" + Math.max(...counts) + " of " + all + " sets)"; }
    if (chart.share) { words += "; " + Math.round(chart.share[k] / 10) + " % of the landings rest within " + content.long; }
    if (chart.decides && chart.decides[k]) { words += "; " + chart.decides[k] + " decides"; }
    if (chart.doubt && chart.doubt[k] === "1") { words += "; half the tolerance changes a class here"; }
    text("cell", ["x", "y"].map((axis) => chart[axis].name + " " + said(axis, shown[axis])).join(", ") + ": " + words);
    find("is", "rows").replaceChildren(...chart.rows.map((name, r) => {
      const line = document.createElement("tr"), code = Number(chart.outcome[r][k]);
      const cells = [name, content.words[code], thousandths(chart.distance[r][k], "m"), thousandths(chart.time[r][k], "s")];
      cells.forEach(function (words, c) {
        const one = document.createElement(c ? "td" : "th");
        if (!c) { one.scope = "row"; }
        if (c > 1) { one.className = "number"; }
        if (c === 1) { one.className = "prose"; one.append(patch(code)); }
        one.append(words);
        line.appendChild(one);
      });
      return line;
    }));
    const fields = [chart.x.texts[shown.x], chart.y.texts[shown.y], ...chart.texts.map((one) => one[k])];
    const command = chart.command.map((part) => (typeof part === "number" ? fields[part] : part)).join("");
    // A line breaks between two words only: "-" and "-slope" on two lines would not be read as one.
    find("is", "command").replaceChildren(...command.split(" ").flatMap(function (word, k) {
      const piece = document.createElement("span");
      piece.textContent = word;
      return k ? [" ", piece] : [piece];
    }));
    text("copied", "");
    draw();
  }

  function colour(k) {
    const sum = [0, 0, 0];
    let sound = 0;
    for (const row of chart.outcome) {
      const code = Number(row[k]);
      if (code !== lost) { sound += 1; classes[code].forEach((part, i) => { sum[i] += part; }); }
    }
    return sound ? "rgb(" + sum.map((part) => Math.round(part / sound)).join(",") + ")" : content.colours[lost];
  }

  function draw() {
    const width = canvas.clientWidth, height = canvas.clientHeight, sharp = window.devicePixelRatio || 1;
    if (!width) { return; }
    canvas.width = Math.round(width * sharp);
    canvas.height = Math.round(height * sharp);
    pen.setTransform(sharp, 0, 0, sharp, 0, 0);
    pen.clearRect(0, 0, width, height);
    box = { x: scale(chart.x.edges, place.left, width - place.right), y: scale(chart.y.edges, height - place.bottom, place.top) };
    const across = chart.x.texts.length;
    for (let y = 0; y < chart.y.texts.length; y++) {
      for (let x = 0; x < across; x++) {
        pen.fillStyle = colour(y * across + x);
        // Half a pixel more: no seams between cells.
        pen.fillRect(box.x[x], box.y[y + 1], box.x[x + 1] - box.x[x] + 0.5, box.y[y] - box.y[y + 1] + 0.5);
      }
    }
    const ink = getComputedStyle(root).color;
    pen.strokeStyle = ink;
    pen.lineWidth = 1;
    pen.strokeRect(box.x[0], box.y[box.y.length - 1], box.x[across] - box.x[0], box.y[0] - box.y[box.y.length - 1]);
    pen.fillStyle = ink;
    pen.font = "13px system-ui, sans-serif";
    pen.textAlign = "center";
    pen.textBaseline = "top";
    ticks("x", 46, (at, words) => pen.fillText(words, at, height - place.bottom + 6));
    pen.fillText(label("x"), (box.x[0] + box.x[across]) / 2, height - 18);
    pen.textAlign = "right";
    pen.textBaseline = "middle";
    ticks("y", 26, (at, words) => pen.fillText(words, place.left - 6, at));
    pen.save();
    pen.translate(12, (box.y[0] + box.y[box.y.length - 1]) / 2);
    pen.rotate(-Math.PI / 2);
    pen.textAlign = "center";
    pen.fillText(label("y"), 0, 0);
    pen.restore();
    frame(pinned, "#ffffff", "#000000", 5, 2.5);
    if (shown.x !== pinned.x || shown.y !== pinned.y) { frame(shown, "#000000", "#ffffff", 3, 1); }
  }

  function frame(at, outer, inner, wide, narrow) {
    for (const [style, width] of [[outer, wide], [inner, narrow]]) {
      pen.strokeStyle = style;
      pen.lineWidth = width;
      pen.strokeRect(box.x[at.x], box.y[at.y + 1], box.x[at.x + 1] - box.x[at.x], box.y[at.y] - box.y[at.y + 1]);
    }
  }

  function scale(edges, from, to) {
    const low = edges[0], span = edges[edges.length - 1] - low;
    return edges.map((edge) => from + ((edge - low) / span) * (to - from));
  }

  function ticks(axis, apart, write) {
    const texts = chart[axis].texts, at = box[axis];
    const room = Math.max(1, Math.abs(at[at.length - 1] - at[0]) / apart);
    const step = [1, 2, 4, 5, 10, 20, 50, 100, 1000].find((every) => texts.length / every <= room) || texts.length;
    for (let k = 0; k < texts.length; k += step) { write((at[k] + at[k + 1]) / 2, texts[k]); }
  }

  function under(event) {
    const frame = canvas.getBoundingClientRect();
    const at = { x: event.clientX - frame.left, y: event.clientY - frame.top }, out = {};
    for (const axis of ["x", "y"]) {
      const edges = box[axis], last = edges.length - 1, rising = edges[last] > edges[0] ? 1 : -1;
      out[axis] = edges.findIndex((edge, k) => k < last && rising * (at[axis] - edge) >= 0 && rising * (at[axis] - edges[k + 1]) < 0);
    }
    return out.x < 0 || out.y < 0 ? null : out;
  }

  function pin(at) { pinned = at; show(at); }

  canvas.addEventListener("pointermove", function (event) {
    const at = event.pointerType === "mouse" ? under(event) : null;
    if (at && (at.x !== shown.x || at.y !== shown.y)) { show(at); }
  });
  canvas.addEventListener("pointerleave", () => { if (shown.x !== pinned.x || shown.y !== pinned.y) { show(pinned); } });
  canvas.addEventListener("click", function (event) { const at = under(event); if (at) { pin(at); } });
  for (const axis of ["x", "y"]) {
    sliders[axis].addEventListener("input", () => pin({ ...pinned, [axis]: Number(sliders[axis].value) }));
  }
  find("do", "chart").addEventListener("change", (event) => choose(Number(event.target.value)));
  find("do", "copy").addEventListener("click", function () {
    const command = find("is", "command");
    const done = () => text("copied", "copied");
    const mark = function () {
      // A page opened from a file may not reach the clipboard: the text is marked instead.
      getSelection().selectAllChildren(command);
      text("copied", document.execCommand("copy") ? "copied" : "marked; press Ctrl+C");
    };
    if (navigator.clipboard) { navigator.clipboard.writeText(command.textContent).then(done, mark); } else { mark(); }
  });
  new ResizeObserver(draw).observe(canvas);
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", draw);
  choose(0);
}
