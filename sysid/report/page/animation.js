(function () {
  "use strict";
  document.documentElement.classList.add("scripted");
  const css = (name) => getComputedStyle(document.documentElement).getPropertyValue("--c-" + name).trim();
  const calm = matchMedia("(prefers-reduced-motion: reduce)").matches;
  const dark = matchMedia("(prefers-color-scheme: dark)");

  function animate(root) {
    const drops = JSON.parse(root.querySelector('script[type="application/json"]').textContent).drops;
    const part = (name) => root.querySelector('[data-do="' + name + '"]');
    const play = part("play"), seek = part("seek"), clock = part("clock"), marks = part("marks"), scenes = root.querySelector(".scenes");
    const words = scenes.querySelector("canvas").getAttribute("aria-label");
    let drop, time = 0, playing = false, last = null, timer = null, canvases = [], newton, colours;

    function choose(index) {
      drop = drops[index];
      part("drop").value = String(index);
      drop.length = (drop.fits[0].frames.length - 1) * drop.step;
      newton = 1;
      for (const fit of drop.fits) for (const f of fit.frames) newton = Math.max(newton, f[7], f[8]);
      seek.max = String(Math.round(drop.length * 1000));
      scenes.classList.toggle("two", drop.fits.length > 1);
      while (scenes.children.length > drop.fits.length) scenes.lastChild.remove();
      while (scenes.children.length < drop.fits.length) scenes.append(document.createElement("canvas"));
      canvases = [...scenes.children];
      canvases.forEach(function (canvas, k) {
        canvas.tabIndex = 0;
        canvas.setAttribute("role", "img");
        canvas.setAttribute("aria-label", drop.fits.length > 1 ? drop.fits[k].name + ". " + words : words);
        canvas.onkeydown = key;
      });
      marks.replaceChildren();
      const place = (t) => (100 * t) / drop.length + "%";
      for (const [foot, start, end] of drop.contacts) {
        const bar = document.createElement("i");
        bar.style.left = place(start);
        bar.style.width = (100 * (end - start)) / drop.length + "%";
        bar.style.top = foot ? "6px" : "0";
        bar.style.background = "var(--c-" + (foot ? "pink" : "green") + ")";
        marks.append(bar);
      }
      drop.snapshots.forEach(function (shot, k) {
        const button = document.createElement("button");
        button.type = "button";
        button.textContent = String(k + 1);
        button.title = shot[1];
        button.style.left = place(shot[0]);
        button.setAttribute("aria-label", "go to instant " + (k + 1) + ": " + shot[1]);
        button.addEventListener("click", function () { stop(); go(shot[0] + 0.004); });
        marks.append(button);
      });
      spread();
      go(0, false);
    }

    /* Instants that are close to each other keep their order and stay apart. */
    function spread() {
      const buttons = [...marks.querySelectorAll("button")], wide = marks.clientWidth, apart = 26;
      let least = -1e9;
      const places = buttons.map((b, k) => (least = Math.max(least + apart, (wide * drop.snapshots[k][0]) / drop.length)));
      const over = places.length ? Math.max(0, places[places.length - 1] - wide) : 0;
      buttons.forEach((b, k) => { b.style.left = places[k] - over + "px"; });
    }

    function go(t, told) {
      time = Math.max(0, Math.min(drop.length, t));
      seek.value = String(Math.round(time * 1000));
      const said = Math.round(time * 1000) + " ms";
      clock.textContent = said;
      seek.setAttribute("aria-valuetext", said);
      root.dataset.time = time.toFixed(4);
      draw();
      if (told !== false) document.dispatchEvent(new CustomEvent("sysid-time", { detail: { key: drop.key, time, from: root } }));
    }

    function stop() {
      playing = false;
      last = null;
      if (timer) { clearTimeout(timer); timer = null; }
      play.textContent = "Play";
      root.dataset.playing = "no";
    }

    function start() {
      if (time >= drop.length - 1e-6) go(0);
      playing = true;
      play.textContent = "Pause";
      root.dataset.playing = "yes";
      if (calm) step(); else requestAnimationFrame(tick);
    }

    function tick(now) {
      if (!playing) return;
      if (last !== null) go(time + (now - last) / 1000 / Number(part("speed").value));
      last = now;
      if (time >= drop.length) stop(); else requestAnimationFrame(tick);
    }

    function step() {
      if (!playing) return;
      const next = drop.snapshots.map((shot) => shot[0] + 0.004).find((t) => t > time + 1e-6);
      if (next === undefined) { go(drop.length); stop(); return; }
      go(next);
      timer = setTimeout(step, 1500);
    }

    function key(event) {
      const keys = {
        " ": () => (playing ? stop() : start()), ArrowLeft: () => { stop(); go(time - drop.step); }, ArrowRight: () => { stop(); go(time + drop.step); },
        Home: () => { stop(); go(0); }, End: () => { stop(); go(drop.length); },
      };
      if (!keys[event.key] || event.ctrlKey || event.metaKey) return;
      event.preventDefault();
      keys[event.key]();
    }

    function at(fit, t) {
      const place = t / drop.step, i = Math.min(Math.floor(place), fit.frames.length - 1), j = Math.min(i + 1, fit.frames.length - 1), share = place - i;
      return fit.frames[i].map((value, n) => value + share * (fit.frames[j][n] - value));
    }

    function draw() {
      colours = Object.fromEntries(["text", "ink", "best", "blue", "faint", "soil", "soil-edge", "body", "paper"].map((name) => [name, css(name)]));
      canvases.forEach((canvas, k) => scene(canvas, drop.fits[k]));
    }

    function scene(canvas, fit) {
      const width = canvas.clientWidth || 600, narrow = width < 450, height = Math.round(width * (narrow ? 1.1 : 0.68)), ratio = devicePixelRatio || 1;
      if (canvas.width !== Math.round(width * ratio)) canvas.width = Math.round(width * ratio);
      if (canvas.height !== Math.round(height * ratio)) canvas.height = Math.round(height * ratio);
      canvas.style.height = height + "px";
      const c = canvas.getContext("2d"), f = at(fit, time), drone = fit.drone, tall = -drone.feet[0][1];
      const arm = Math.max(...drone.rods.flat().map((end) => end[0]));
      // The drone fills its canvas and the view follows it; without following, the whole movement is in view.
      // A narrow view is higher: the words above the drone have room.
      let x0 = f[0], z0 = f[1] - (narrow ? 0.1 : 0.3) * tall, k = Math.min(width / (2.15 * arm), height / (2.6 * tall));
      if (!part("follow").checked) {
        const xs = fit.frames.map((g) => g[0]), zs = fit.frames.map((g) => g[1]);
        const box = [Math.min(...xs) - arm, Math.max(...xs) + arm, Math.min(...zs) - 1.3 * tall, Math.max(...zs) + 0.8 * tall];
        x0 = (box[0] + box[1]) / 2; z0 = (box[2] + box[3]) / 2;
        k = Math.min(width / (box[1] - box[0]), height / (box[3] - box[2]));
      }
      root.dataset.filled = ((2 * arm * k) / width).toFixed(3);
      c.setTransform(ratio, 0, 0, ratio, 0, 0);
      c.clearRect(0, 0, width, height);
      const X = (x) => width / 2 + (x - x0) * k, Z = (z) => height / 2 - (z - z0) * k;
      const line = function (a, b, d, e) { c.beginPath(); c.moveTo(X(a), Z(b)); c.lineTo(X(d), Z(e)); c.stroke(); };
      const along = [Math.cos(drop.slope), -Math.sin(drop.slope)], up = [-along[1], along[0]];
      c.beginPath();
      for (const [a, b] of [[-4e4, 0], [4e4, 0], [4e4, -4e4], [-4e4, -4e4]]) c.lineTo(X(a * along[0] + b * up[0]), Z(a * along[1] + b * up[1]));
      c.closePath();
      c.fillStyle = colours.soil; c.fill();
      c.strokeStyle = colours["soil-edge"]; c.lineWidth = 1.5; c.stroke();
      // A mark on the slope every 10 cm shows that it passes by.
      c.lineWidth = 1;
      for (let m = -40; m <= 40; m++) line(1000 * m * along[0], 1000 * m * along[1], 1000 * m * along[0] - 110 * up[0], 1000 * m * along[1] - 110 * up[1]);
      if (part("path").checked) {
        track(fit.frames.map((g) => [g[0], g[1]]), colours.best);
        track(drop.fits[0].frames.filter((g) => g[11] < 8.9e4).map((g) => [g[11], g[12]]), colours.faint);
      }
      const measured = at(drop.fits[0], time).slice(11);
      if (part("ghost").checked && measured[0] < 8.9e4) shape(measured, null, colours.faint, 1.3, null);
      c.setLineDash([3, 4]);
      c.strokeStyle = colours.faint; c.lineWidth = 1;
      const body = placed(f);
      drone.joints.forEach((joint, k) => line(...body(joint), ...body(drone.feet[k])));
      c.setLineDash([]);
      shape(f, [[f[3], f[4]], [f[5], f[6]]], colours.ink, 2.6, colours.body);
      c.beginPath(); c.arc(X(f[0]), Z(f[1]), 4, 0, 7); c.fillStyle = colours.best; c.fill();
      // Forces to scale: the largest one of the drop is as long as a leg.
      const scale = (0.95 * tall * k) / newton;
      for (const foot of [0, 1]) {
        const x = X(f[3 + 2 * foot]), z = Z(f[4 + 2 * foot]);
        arrow(x, z, up, f[7 + foot] * scale, colours.blue);
        arrow(x, z, along, f[9 + foot] * scale, colours.best);
      }
      legend();

      function track(points, colour) {
        c.strokeStyle = colour; c.lineWidth = 1.2; c.setLineDash([1, 3]);
        c.beginPath();
        for (const p of points) c.lineTo(X(p[0]), Z(p[1]));
        c.stroke();
        c.setLineDash([]);
      }
      /* From the body's frame to frame N, for a body at x, z and pitch. */
      function placed([x, z, q]) {
        const sine = Math.sin(q / 1e4), cosine = Math.cos(q / 1e4);
        return ([a, b]) => [x + a * cosine + b * sine, z - a * sine + b * cosine];
      }
      /* The drone as sysid.report.drop_replay.DroneShape describes it; without feet of its own its legs are at rest. */
      function shape(pose, feet, colour, thick, fill) {
        const body = placed(pose);
        c.strokeStyle = colour; c.lineWidth = thick; c.lineCap = "round";
        drone.joints.forEach(function (joint, k) {
          const foot = feet ? feet[k] : body(drone.feet[k]);
          line(...body(joint), ...foot);
          c.beginPath(); c.arc(X(foot[0]), Z(foot[1]), thick + 1, 0, 7); c.fillStyle = colour; c.fill();
        });
        for (const [from, to] of drone.rods) line(...body(from), ...body(to));
        c.beginPath();
        for (const p of drone.hull.map(body)) c.lineTo(X(p[0]), Z(p[1]));
        c.closePath();
        if (fill) { c.fillStyle = fill; c.fill(); }
        c.stroke();
      }
      function arrow(x, z, way, size, colour) {
        if (Math.abs(size) < 2) return;
        const b = [x + way[0] * size, z - way[1] * size], turn = Math.atan2(b[1] - z, b[0] - x), head = Math.min(10, 0.6 * Math.abs(size));
        c.strokeStyle = c.fillStyle = colour; c.lineWidth = 3;
        c.beginPath(); c.moveTo(x, z); c.lineTo(b[0] - 0.7 * head * Math.cos(turn), b[1] - 0.7 * head * Math.sin(turn)); c.stroke();
        c.beginPath(); c.moveTo(b[0], b[1]);
        for (const side of [2.7, -2.7]) c.lineTo(b[0] + head * Math.cos(turn + side), b[1] + head * Math.sin(turn + side));
        c.closePath(); c.fill();
      }
      function legend() {
        // The slope rises to the left: the right upper corner is free.
        const row = narrow ? 15 : 18;
        c.font = (narrow ? 11 : 13) + "px system-ui, sans-serif"; c.textBaseline = "middle"; c.textAlign = "right"; c.fillStyle = colours.text;
        c.fillText((drop.fits.length > 1 ? fit.name + ", " : "") + drop.name + " (" + drop.use + ")", width - 10, 14);
        c.fillText("rear " + Math.round(f[7]) + " N, front " + Math.round(f[8]) + " N", width - 10, 14 + row);
        const nice = [1, 2, 5, 10, 20, 50, 100, 200, 500, 1000].filter((n) => n * scale <= (narrow ? 50 : 90)).pop() || 1;
        const rows = [["normal force", colours.blue], ["friction", colours.best]];
        rows.forEach(function ([text, colour], n) {
          c.fillStyle = colours.text; c.textAlign = "right";
          c.fillText(text, width - 10 - nice * scale - 8, 14 + row * (n + 2));
          arrow(width - 10 - nice * scale, 14 + row * (n + 2), [1, 0], nice * scale, colour);
        });
        c.fillStyle = colours.text; c.fillText(nice + " N", width - 10, 14 + 4 * row);
        if (part("ghost").checked) { c.fillStyle = colours.faint; c.fillText("measured", width - 10, 14 + 5 * row); }
      }
    }

    play.addEventListener("click", function () { if (playing) stop(); else start(); });
    seek.addEventListener("input", function () { stop(); go(Number(seek.value) / 1000); });
    part("drop").addEventListener("change", function (event) {
      stop();
      choose(Number(event.target.value));
      document.dispatchEvent(new CustomEvent("sysid-view", { detail: { key: drop.key, from: root } }));
    });
    for (const name of ["ghost", "path", "follow"]) part(name).addEventListener("change", draw);
    document.addEventListener("sysid-view", function (event) {
      const k = drops.findIndex((each) => each.key === event.detail.key);
      if (event.detail.from !== root && k >= 0 && drops[k] !== drop) { stop(); choose(k); }
    });
    document.addEventListener("sysid-time", function (event) {
      if (event.detail.from === root || event.detail.key !== drop.key || playing) return;
      go(event.detail.time, false);
    });
    new ResizeObserver(() => { spread(); draw(); }).observe(scenes);
    dark.addEventListener("change", draw);
    stop();
    choose(Number(part("drop").value));
  }
  // Drops are read when they come near, so that the page is ready at once.
  const near = new IntersectionObserver((entries) => {
    for (const entry of entries) {
      if (!entry.isIntersecting) continue;
      near.unobserve(entry.target);
      animate(entry.target);
      document.dispatchEvent(new CustomEvent("sysid-join"));
      entry.target.dataset.ready = "yes";
    }
  }, { rootMargin: "300px" });
  for (const root of document.querySelectorAll("[data-animation]")) near.observe(root);
})();
