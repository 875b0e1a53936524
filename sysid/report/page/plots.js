(function () {
  "use strict";
  document.documentElement.classList.add("scripted");
  const css = (name) => getComputedStyle(document.documentElement).getPropertyValue("--c-" + name).trim() || "#888";
  const bars = ["green", "pink", "amber"];
  const dark = window.matchMedia("(prefers-color-scheme: dark)");

  function unpack(text) {
    const raw = atob(text), bytes = new Uint8Array(raw.length);
    for (let i = 0; i < raw.length; i++) bytes[i] = raw.charCodeAt(i);
    return Array.from(new Float32Array(bytes.buffer), (v) => (Number.isFinite(v) ? v : null));
  }
  function brief(value) {
    if (value === null || value === undefined || !Number.isFinite(value)) return "—";
    const size = Math.abs(value);
    return (size !== 0 && (size < 1e-4 || size >= 1e6) ? value.toExponential(3) : String(Number(value.toPrecision(4)))).replace("-", "−");
  }
  // The edges of a grey band are marked where they can be told apart.
  function levels(shade, low, high, step) {
    if (high - low < 5 * (shade[1] - shade[0])) return [shade[0], (shade[0] + shade[1]) / 2, shade[1]];
    const first = Math.ceil(low / step), count = Math.floor(high / step) - first + 1;
    return Array.from({ length: Math.max(0, count) }, (_, k) => (first + k) * step);
  }
  function save(name, kind, text) {
    const link = document.createElement("a");
    link.href = URL.createObjectURL(new Blob([text], { type: kind }));
    link.download = name.replace(/[^A-Za-z0-9._-]+/g, "-");
    document.body.append(link);
    link.click();
    link.remove();
    setTimeout(() => URL.revokeObjectURL(link.href), 10000);
  }
  function element(tag, kind, text) {
    const out = document.createElement(tag);
    if (kind) out.className = kind;
    if (text !== undefined) out.textContent = text;
    return out;
  }

  class Plot {
    constructor(root) {
      this.root = root;
      this.stage = root.querySelector(".stage");
      this.status = root.querySelector("[role=status]");
      this.data = JSON.parse(root.querySelector('script[type="application/json"]').textContent);
      this.hidden = new Set();
      this.plots = [];
      this.fingers = new Map();
      this.pinch = null;
      this.at = null;
      for (const button of root.querySelectorAll("button[data-do]")) {
        button.addEventListener("click", () => this.act(button.dataset.do));
      }
      this.choice = root.querySelector('[data-do="view"]');
      if (this.choice) {
        this.choice.addEventListener("change", () => {
          this.choose(Number(this.choice.value));
          this.tell("sysid-view", { key: this.view.key });
        });
      }
      this.stage.addEventListener("keydown", (event) => this.key(event));
      document.addEventListener("sysid-view", (event) => {
        const k = this.data.views.findIndex((view) => view.key === event.detail.key);
        if (event.detail.from !== this && k >= 0 && this.view !== this.data.views[k]) this.choose(k);
      });
      document.addEventListener("sysid-time", (event) => {
        if (event.detail.from !== this && event.detail.key === this.view.key) this.cursor(event.detail.time, false);
      });
      dark.addEventListener("change", () => this.build());
      new ResizeObserver(() => this.resize()).observe(this.stage);
      this.choose(this.data.chosen);
    }

    tell(name, detail) { document.dispatchEvent(new CustomEvent(name, { detail: { ...detail, from: this } })); }

    choose(k) {
      const view = this.view = this.data.views[k];
      if (this.choice) this.choice.value = String(k);
      if (!view.xs) {
        view.xs = unpack(view.x);
        for (const panel of view.panels) {
          for (const curve of panel.curves) {
            curve.ys = unpack(curve.y);
            if (curve.upto) curve.tops = unpack(curve.upto);
          }
        }
      }
      this.full = [view.xs[0], view.xs[view.xs.length - 1]];
      this.range = this.full.slice();
      this.at = null;
      this.root.dataset.view = view.key;
      this.toggles();
      this.build();
    }

    toggles() {
      const box = this.root.querySelector(".toggles"), labels = new Map();
      for (const panel of this.view.panels) for (const c of panel.curves) if (!labels.has(c.label)) labels.set(c.label, [c.colour, c.upto ? "area" : c.look]);
      this.view.bars.forEach((bar, k) => labels.set(bar.label, [bars[k % bars.length], "bar"]));
      box.replaceChildren();
      for (const [label, [colour, look]] of labels) {
        const item = element("label", "toggle"), input = element("input"), swatch = element("span", "swatch " + look);
        input.type = "checkbox";
        input.checked = !this.hidden.has(label);
        swatch.style.color = "var(--c-" + colour + ")";
        input.addEventListener("change", () => {
          if (input.checked) this.hidden.delete(label); else this.hidden.add(label);
          this.build();
        });
        item.append(input, swatch, label);
        box.append(item);
      }
    }

    build() {
      for (const plot of this.plots) plot.destroy();
      this.stage.replaceChildren();
      this.width = this.stage.clientWidth || 600;
      this.plots = this.view.panels.map((panel, k) => this.panel(panel, k));
      this.zoom(...this.range);
      if (this.at !== null) this.cursor(this.at, false);
    }

    panel(panel, k) {
      const box = element("div", "panel" + (panel.low ? " low" : "")), head = element("div", "head");
      const values = element("span", "values");
      head.append(element("b", "", panel.label + (panel.unit && panel.unit !== "1" ? " [" + panel.unit + "]" : "")), values);
      box.append(head);
      this.stage.append(box);
      const data = [this.view.xs], series = [{}], bands = [], seen = [];
      for (const c of panel.curves) {
        const show = !this.hidden.has(c.label), stroke = css(c.colour);
        const look = { show, stroke, width: { thin: 1, thick: 3.2 }[c.look] || 1.8, spanGaps: !!c.spans, auto: !c.loose && !c.upto, points: { show: false } };
        if (c.look === "dashed") look.dash = [6, 4];
        if (c.look === "steps") look.paths = uPlot.paths.stepped({ align: 1 });
        if (c.look === "dots") { look.paths = () => null; look.points = { show: true, size: 4.5, fill: stroke, width: 0 }; }
        if (c.upto) {
          const edge = { ...look, width: 0.6, dash: undefined };
          data.push(c.tops, c.ys);
          series.push(edge, edge);
          if (show) bands.push({ series: [series.length - 2, series.length - 1], fill: stroke + "38" });
        } else {
          data.push(c.ys);
          series.push(look);
        }
        seen.push([c, data.length - 1]);
      }
      const last = k === this.view.panels.length - 1;
      const axis = { stroke: css("text"), grid: { stroke: css("grid"), width: 1 }, ticks: { stroke: css("grid"), width: 1 }, font: "12px system-ui, sans-serif", values: (u, ticks) => ticks.map((v) => (v === null ? "" : String(Number(v.toPrecision(6))).replace("-", "−"))) };
      const options = {
        width: this.width, height: (panel.low ? 66 : 132) + (last ? 38 : 0), padding: [5, 18, 0, 0], series, bands, legend: { show: false },
        scales: { x: { time: false, range: () => this.range }, y: { range: (u, low, high) => this.span(low, high, panel) } },
        axes: [
          { ...axis, show: true, size: last ? 44 : 8, ...(last ? {} : { values: () => [] }), label: last ? this.data.x[0] + " [" + this.data.x[1] + "]" : undefined, labelSize: last ? 16 : 0, labelFont: "12px system-ui, sans-serif" },
          { ...axis, size: 58, space: panel.low ? 16 : 30, splits: panel.shade ? (u, i, low, high, step) => levels(panel.shade, low, high, step) : undefined },
        ],
        cursor: { sync: { key: null }, drag: { x: true, y: false, setScale: false }, points: { size: 7 }, y: false },
        hooks: {
          drawAxes: [(u) => this.under(u, panel)],
          setSelect: [(u) => {
            if (u.select.width > 3) this.zoom(u.posToVal(u.select.left, "x"), u.posToVal(u.select.left + u.select.width, "x"));
            u.setSelect({ left: 0, top: 0, width: 0, height: 0 }, false);
          }],
        },
      };
      const plot = new uPlot(options, data, box);
      // The stage around all panels has the words.
      plot.ctx.canvas.setAttribute("aria-hidden", "true");
      plot.shown = { seen, values, panel };
      this.feel(plot);
      return plot;
    }

    span(low, high, panel) {
      if (low === null || !Number.isFinite(low)) return panel.shade || [0, 1];
      if (panel.shade) { low = Math.min(low, panel.shade[0]); high = Math.max(high, panel.shade[1]); }
      const margin = 0.06 * (high - low) || Math.abs(low) * 0.05 || 1;
      return [low - margin, high + margin];
    }

    under(u, panel) {
      const c = u.ctx, box = u.bbox, ratio = devicePixelRatio;
      c.save();
      c.beginPath(); c.rect(box.left, box.top, box.width, box.height); c.clip();
      if (panel.shade) {
        const [a, b] = panel.shade.map((v) => u.valToPos(v, "y", true));
        c.fillStyle = css("grid"); c.globalAlpha = 0.6;
        c.fillRect(box.left, b, box.width, a - b);
        c.globalAlpha = 1;
      }
      if (!panel.low) this.view.bars.forEach((bar, k) => {
        if (this.hidden.has(bar.label)) return;
        c.fillStyle = css(bars[k % bars.length]);
        for (const [from, to] of bar.spans) {
          const a = u.valToPos(from, "x", true), b = u.valToPos(to, "x", true);
          c.fillRect(a, box.top + box.height - (5 * (k + 1) - 1) * ratio, Math.max(b - a, 2 * ratio), 3.5 * ratio);
        }
      });
      c.restore();
    }

    /* Mouse and fingers: hover, shift and drag pans, two fingers zoom and pan; a page still scrolls upwards. */
    feel(u) {
      const over = u.over, fingers = this.fingers;
      let held = null;
      over.style.touchAction = "pan-y";
      const place = (event) => event.clientX - over.getBoundingClientRect().left;
      over.addEventListener("mousemove", (event) => { if (!held) this.cursor(u.posToVal(place(event), "x"), true); });
      over.addEventListener("mousedown", (event) => {
        if (!event.shiftKey) return;
        event.stopImmediatePropagation(); event.preventDefault();
        held = { x: event.clientX, range: this.range.slice() };
        const move = (e) => this.shift(held.range, (held.x - e.clientX) / over.clientWidth);
        const drop = () => { held = null; removeEventListener("mousemove", move); removeEventListener("mouseup", drop); };
        addEventListener("mousemove", move); addEventListener("mouseup", drop);
      }, true);
      over.addEventListener("dblclick", (event) => { event.stopImmediatePropagation(); this.zoom(...this.full); }, true);
      over.addEventListener("wheel", (event) => {
        if (!event.ctrlKey && !event.metaKey) return;
        event.preventDefault();
        this.scale(event.deltaY > 0 ? 1.25 : 0.8, u.posToVal(place(event), "x"));
      }, { passive: false });
      over.addEventListener("pointerdown", (event) => {
        if (event.pointerType !== "touch") return;
        fingers.set(event.pointerId, event.clientX);
        if (fingers.size === 1) this.cursor(u.posToVal(place(event), "x"), true);
        if (fingers.size === 2) this.pinch = { xs: [...fingers.values()], range: this.range.slice() };
      });
      over.addEventListener("pointermove", (event) => {
        if (!fingers.has(event.pointerId)) return;
        fingers.set(event.pointerId, event.clientX);
        if (fingers.size === 1) this.cursor(u.posToVal(place(event), "x"), true);
        if (fingers.size !== 2 || !this.pinch) return;
        const now = [...fingers.values()], box = over.getBoundingClientRect(), [a, b] = this.pinch.range, xs = this.pinch.xs;
        const share = (x) => (x - box.left) / box.width;
        const was = (x) => a + share(x) * (b - a);
        // What lay under each finger stays under it.
        const wide = (was(xs[1]) - was(xs[0])) / ((share(now[1]) - share(now[0])) || 1e-3);
        const from = was(xs[0]) - share(now[0]) * wide;
        if (wide > 0) this.zoom(from, from + wide);
      });
      for (const end of ["pointerup", "pointercancel", "pointerleave"]) {
        over.addEventListener(end, (event) => { fingers.delete(event.pointerId); if (fingers.size < 2) this.pinch = null; });
      }
    }

    key(event) {
      const xs = this.view.xs, keys = {
        ArrowLeft: () => (event.shiftKey ? this.act("left") : this.step(-1)), ArrowRight: () => (event.shiftKey ? this.act("right") : this.step(1)),
        Home: () => this.cursor(this.range[0], true), End: () => this.cursor(this.range[1], true),
        "+": () => this.act("in"), "=": () => this.act("in"), "-": () => this.act("out"), "0": () => this.act("reset"), Escape: () => this.act("reset"),
      };
      if (!keys[event.key] || event.ctrlKey || event.metaKey || !xs.length) return;
      event.preventDefault();
      keys[event.key]();
      if (this.at !== null) this.status.textContent = this.data.x[0] + " " + brief(this.at) + " " + this.data.x[1] + ": " + this.plots.map((u) => u.shown.panel.label + " " + u.shown.values.textContent).join("; ");
    }

    step(by) {
      const xs = this.view.xs, now = this.at === null ? (by > 0 ? this.range[0] : this.range[1]) : this.at;
      let k = this.nearest(now) + by;
      k = Math.max(0, Math.min(xs.length - 1, k));
      if (xs[k] < this.range[0] || xs[k] > this.range[1]) this.shift(this.range, 0.5 * by);
      this.cursor(xs[k], true);
    }

    act(what) {
      const middle = this.at !== null && this.at >= this.range[0] && this.at <= this.range[1] ? this.at : (this.range[0] + this.range[1]) / 2;
      const acts = {
        in: () => this.scale(0.5, middle), out: () => this.scale(2, middle), left: () => this.shift(this.range, -0.25),
        right: () => this.shift(this.range, 0.25), reset: () => this.zoom(...this.full),
        csv: () => save(this.view.key + ".csv", "text/csv", this.csv()), svg: () => save(this.view.key + ".svg", "image/svg+xml", this.svg()),
      };
      if (acts[what]) acts[what]();
    }

    scale(factor, about) { this.zoom(about - (about - this.range[0]) * factor, about + (this.range[1] - about) * factor); }

    shift([a, b], share) {
      const by = Math.max(this.full[0] - a, Math.min(this.full[1] - b, share * (b - a)));
      this.zoom(a + by, b + by);
    }

    zoom(low, high) {
      const least = (this.full[1] - this.full[0]) / 2000;
      if (!(high - low > least)) { const middle = (low + high) / 2; low = middle - least / 2; high = middle + least / 2; }
      this.range = [Math.max(this.full[0], low), Math.min(this.full[1], high)];
      if (this.range[1] <= this.range[0]) this.range = this.full.slice();
      this.root.dataset.range = this.range.map((v) => v.toFixed(6)).join(" ");
      for (const u of this.plots) u.setScale("x", { min: this.range[0], max: this.range[1] });
      if (this.at !== null) this.cursor(this.at, false);
    }

    nearest(time) {
      const xs = this.view.xs;
      let low = 0, high = xs.length - 1;
      while (high - low > 1) { const middle = (low + high) >> 1; if (xs[middle] < time) low = middle; else high = middle; }
      return time - xs[low] < xs[high] - time ? low : high;
    }

    /* Curves with places of their own have gaps between them: the nearest value within 2 % of the window counts. */
    value(ys, k) {
      if (ys[k] !== null) return ys[k];
      const xs = this.view.xs, reach = (this.range[1] - this.range[0]) / 50;
      for (let d = 1; d < xs.length; d++) {
        const left = k - d, right = k + d, l = left >= 0 && xs[k] - xs[left] <= reach, r = right < xs.length && xs[right] - xs[k] <= reach;
        if (l && ys[left] !== null) return ys[left];
        if (r && ys[right] !== null) return ys[right];
        if (!l && !r) return null;
      }
      return null;
    }

    cursor(time, told) {
      this.at = Math.max(this.full[0], Math.min(this.full[1], time));
      const k = this.nearest(this.at);
      this.root.dataset.time = this.at.toFixed(5);
      for (const u of this.plots) {
        u.setCursor({ left: u.valToPos(this.at, "x"), top: 10 }, false);
        u.shown.values.replaceChildren();
        for (const [c] of u.shown.seen) {
          // Of several curves of one name, such as the other sets, none is read.
          if (this.hidden.has(c.label) || u.shown.seen.filter(([each]) => each.label === c.label).length > 1) continue;
          const find = (ys) => brief(c.spans ? this.value(ys, k) : ys[k]);
          const piece = element("span", "", c.label + " " + (c.upto ? find(c.ys) + " to " + find(c.tops) : find(c.ys)));
          const mark = element("i", "dot");
          mark.style.background = "var(--c-" + c.colour + ")";
          piece.prepend(mark);
          u.shown.values.append(piece);
        }
      }
      if (told) this.tell("sysid-time", { key: this.view.key, time: this.at });
    }

    resize() {
      const width = this.stage.clientWidth;
      if (!width || Math.abs(width - this.width) < 2) return;
      this.width = width;
      for (const u of this.plots) u.setSize({ width, height: u.height });
    }

    csv() {
      // A spreadsheet takes a text that starts so for a formula.
      const quoted = (text) => '"' + (/^[=+\-@\t]/.test(text) ? "'" : "") + text.replace(/"/g, '""') + '"';
      const heads = [this.data.x[0] + " [" + this.data.x[1] + "]"], columns = [this.view.xs];
      for (const panel of this.view.panels) {
        for (const c of panel.curves) {
          const name = panel.label + ", " + c.label, unit = " [" + (panel.unit || "1") + "]";
          if (c.upto) { heads.push(name + ", low" + unit, name + ", high" + unit); columns.push(c.ys, c.tops); } else { heads.push(name + unit); columns.push(c.ys); }
        }
      }
      const row = (i) => columns.map((ys) => (ys[i] === null ? "" : Number(ys[i].toPrecision(7)))).join(",");
      return "\ufeff" + [heads.map(quoted).join(","), ...this.view.xs.map((_, i) => row(i))].join("\r\n") + "\r\n";
    }

    svg() {
      const safe = (text) => text.replace(/&/g, "&amp;").replace(/</g, "&lt;").replace(/>/g, "&gt;");
      const width = 900, left = 80, right = 20, out = [];
      let top = 34;
      for (const u of this.plots) {
        const { panel } = u.shown, height = panel.low ? 60 : 130, { min, max } = u.scales.y, wide = width - left - right;
        const X = (x) => left + (wide * (x - this.range[0])) / (this.range[1] - this.range[0]);
        const Y = (y) => top + height - (height * (y - min)) / (max - min);
        const at = (x, y) => X(x).toFixed(2) + " " + Y(y).toFixed(2);
        out.push(`<clipPath id="p${top}"><rect x="${left}" y="${top}" width="${wide}" height="${height}"/></clipPath><g clip-path="url(#p${top})">`);
        for (const c of panel.curves) {
          if (this.hidden.has(c.label)) continue;
          const colour = css(c.colour), points = [];
          this.view.xs.forEach((x, i) => {
            if (c.ys[i] === null) { if (!c.spans) points.push(null); } else points.push(at(x, c.ys[i]));
          });
          if (c.upto) {
            const back = [];
            this.view.xs.forEach((x, i) => { if (c.tops[i] !== null) back.unshift(at(x, c.tops[i])); });
            out.push(`<path fill="${colour}" fill-opacity="0.22" d="M${[...points.filter((p) => p), ...back].join("L")}Z"/>`);
          } else if (c.look === "dots") {
            out.push(...points.filter((p) => p).map((p) => `<circle cx="${p.split(" ")[0]}" cy="${p.split(" ")[1]}" r="1.6" fill="${colour}"/>`));
          } else {
            let pen = "M";
            const path = points.map((p) => { if (!p) { pen = "M"; return ""; } const piece = pen + p; pen = "L"; return piece; }).join("");
            out.push(`<path fill="none" stroke="${colour}" stroke-width="${{ thin: 0.8, thick: 2.6 }[c.look] || 1.5}" d="${path || "M0 0"}"/>`);
          }
        }
        out.push(`</g><rect x="${left}" y="${top}" width="${wide}" height="${height}" fill="none" stroke="${css("text")}"/>`);
        for (const y of u.axes[1]._splits || []) if (y >= min && y <= max) out.push(`<text x="${left - 6}" y="${Y(y) + 4}" text-anchor="end">${brief(y)}</text>`);
        out.push(`<text x="${left}" y="${top - 5}" font-weight="bold">${safe(panel.label)}${panel.unit && panel.unit !== "1" ? " [" + safe(panel.unit) + "]" : ""}</text>`);
        top += height + 26;
      }
      const u = this.plots[this.plots.length - 1];
      for (const x of u.axes[0]._splits || []) if (x >= this.range[0] && x <= this.range[1]) out.push(`<text x="${left + ((width - left - right) * (x - this.range[0])) / (this.range[1] - this.range[0])}" y="${top - 10}" text-anchor="middle">${brief(x)}</text>`);
      out.push(`<text x="${width / 2}" y="${top + 8}" text-anchor="middle">${safe(this.data.x[0])} [${safe(this.data.x[1])}]</text>`);
      return `<svg xmlns="http://www.w3.org/2000/svg" width="${width}" height="${top + 20}" viewBox="0 0 ${width} ${top + 20}" font-family="sans-serif" font-size="12" fill="${css("text")}"><rect width="100%" height="100%" fill="${css("paper")}"/><text x="${left}" y="14" font-weight="bold">${safe(this.view.title)}</text>${out.join("")}</svg>`;
    }
  }

  function begin() {
    const near = new IntersectionObserver((entries) => {
      for (const entry of entries) {
        if (!entry.isIntersecting) continue;
        near.unobserve(entry.target);
        entry.target.plot = new Plot(entry.target);
        document.dispatchEvent(new CustomEvent("sysid-join"));
        entry.target.dataset.ready = "yes";
      }
    }, { rootMargin: "300px" });
    for (const root of document.querySelectorAll("[data-plot]")) near.observe(root);
  }
  begin();
})();
