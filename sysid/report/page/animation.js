(function () {
  "use strict";
  const root = document.currentScript.parentElement;
  const drops = JSON.parse(root.querySelector('script[type="application/json"]').textContent).drops;
  const canvas = root.querySelector("canvas");
  const part = (name) => root.querySelector('[data-do="' + name + '"]');
  const play = part("play"), seek = part("seek"), clock = part("clock"), instants = part("instants");
  const calm = window.matchMedia && window.matchMedia("(prefers-reduced-motion: reduce)").matches;
  const blue = "#0072B2", red = "#D55E00", ghostly = "#9a9a9a";
  let drop, time = 0, playing = false, last = null, timer = null, view, force;

  function choose(index) {
    drop = drops[index];
    drop.length = (drop.frames.length - 1) * drop.step;
    let low = [1e9, 1e9], high = [-1e9, -1e9];
    force = 1;
    for (const f of drop.frames) {
      for (let i = 0; i < 2; i++) {
        low[i] = Math.min(low[i], f[i]);
        high[i] = Math.max(high[i], f[i]);
      }
      force = Math.max(force, f[11], f[12]);
    }
    view = { x: (low[0] + high[0]) / 2, z: (low[1] + high[1]) / 2,
      width: high[0] - low[0] + 5600, height: high[1] - low[1] + 4200 };
    seek.max = String(Math.round(drop.length * 1000));
    instants.replaceChildren();
    drop.snapshots.forEach(function (shot, k) {
      const button = document.createElement("button");
      button.type = "button";
      button.textContent = "(" + (k + 1) + ")";
      button.title = shot[1];
      button.setAttribute("aria-label", "go to instant " + (k + 1) + ": " + shot[1]);
      button.addEventListener("click", function () { stop(); go(shot[0] + 0.004); });
      instants.appendChild(button);
    });
    go(0);
  }

  function go(t) {
    time = Math.max(0, Math.min(drop.length, t));
    seek.value = String(Math.round(time * 1000));
    const said = Math.round(time * 1000) + " ms";
    clock.textContent = said;
    seek.setAttribute("aria-valuetext", said);
    root.dataset.time = time.toFixed(4);
    draw();
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

  function draw() {
    const width = canvas.clientWidth || 600, height = Math.round(width * (width < 600 ? 0.75 : 0.5));
    const ratio = window.devicePixelRatio || 1;
    if (canvas.width !== Math.round(width * ratio)) canvas.width = Math.round(width * ratio);
    if (canvas.height !== Math.round(height * ratio)) canvas.height = Math.round(height * ratio);
    canvas.style.height = height + "px";
    const c = canvas.getContext("2d");
    c.setTransform(ratio, 0, 0, ratio, 0, 0);
    c.clearRect(0, 0, width, height);
    const k = Math.min(width / view.width, height / view.height);
    const X = (x) => width / 2 + (x - view.x) * k, Z = (z) => height / 2 - (z - view.z) * k;
    const line = function (x0, z0, x1, z1) { c.beginPath(); c.moveTo(X(x0), Z(z0)); c.lineTo(X(x1), Z(z1)); c.stroke(); };
    const along = [Math.cos(drop.slope), -Math.sin(drop.slope)], up = [-along[1], along[0]];
    c.beginPath();
    for (const [a, b] of [[-4e4, 0], [4e4, 0], [4e4, -4e4], [-4e4, -4e4]]) {
      c.lineTo(X(a * along[0] + b * up[0]), Z(a * along[1] + b * up[1]));
    }
    c.closePath();
    c.fillStyle = "#E9E2D3"; c.fill();
    c.strokeStyle = "#8C7A5B"; c.lineWidth = 1.5; c.stroke();
    const at = time / drop.step, i = Math.min(Math.floor(at), drop.frames.length - 1);
    const j = Math.min(i + 1, drop.frames.length - 1), share = at - i;
    const f = drop.frames[i].map((value, n) => value + share * (drop.frames[j][n] - value));
    const shape = function (x, z, q, legs, colour, width) {
      const s = Math.sin(q / 1e4), o = Math.cos(q / 1e4);
      const P = (a, b) => [x + a * o + b * s, z - a * s + b * o];
      c.strokeStyle = colour; c.lineWidth = width; c.lineCap = "round";
      for (const leg of legs(P)) {
        line(leg[0], leg[1], leg[2], leg[3]);
        const out = (leg[0] - x) * o - (leg[1] - z) * s;
        line(...P(out, 0), leg[0], leg[1]);
        c.beginPath(); c.arc(X(leg[2]), Z(leg[3]), width + 0.8, 0, 7); c.fillStyle = colour; c.fill();
      }
      line(...P(-drop.arm, 0), ...P(drop.arm, 0));
      for (const side of [-1, 1]) {
        line(...P(side * drop.arm, 0), ...P(side * drop.arm, 220));
        line(...P(side * drop.arm - 750, 220), ...P(side * drop.arm + 750, 220));
      }
      c.beginPath();
      for (const [a, b] of [[-550, -220], [550, -220], [550, 220], [-550, 220]]) { const p = P(a, b); c.lineTo(X(p[0]), Z(p[1])); }
      c.closePath();
      return P;
    };
    const rest = (P) => [-1, 1].map((side) => [...P(side * drop.joint[0], -drop.joint[1]), ...P(side * drop.foot[0], -drop.foot[1])]);
    if (part("ghost").checked && f[15] < 8.9e4) {
      shape(f[15], f[16], f[17], rest, ghostly, 1.2);
      c.stroke();
    }
    c.setLineDash([3, 4]);
    c.strokeStyle = "#777"; c.lineWidth = 1;
    const s = Math.sin(f[2] / 1e4), o = Math.cos(f[2] / 1e4);
    for (const leg of rest((a, b) => [f[0] + a * o + b * s, f[1] - a * s + b * o])) line(...leg);
    c.setLineDash([]);
    shape(f[0], f[1], f[2], () => [[f[3], f[4], f[7], f[8]], [f[5], f[6], f[9], f[10]]], "#333", 2.4);
    c.fillStyle = "#ddd"; c.fill(); c.stroke();
    for (const foot of [0, 1]) {
      const x = f[7 + 2 * foot], z = f[8 + 2 * foot];
      arrow(x, z, up, f[11 + foot], blue);
      arrow(x, z, along, f[13 + foot], red);
    }
    c.fillStyle = "#222"; c.font = "13px sans-serif"; c.textBaseline = "top";
    // The slope rises to the left: the right upper corner is free.
    c.textAlign = "right";
    c.fillText(drop.name + " (" + drop.use + ")", width - 8, 8);
    c.fillText("rear " + Math.round(f[11]) + " N, front " + Math.round(f[12]) + " N", width - 8, 26);

    function arrow(x, z, way, newton, colour) {
      const size = 2200 * newton / force;
      if (Math.abs(size) < 25) return;
      const a = [X(x), Z(z)], b = [X(x + way[0] * size), Z(z + way[1] * size)];
      const turn = Math.atan2(b[1] - a[1], b[0] - a[0]);
      c.strokeStyle = c.fillStyle = colour; c.lineWidth = 2.4;
      c.beginPath(); c.moveTo(a[0], a[1]); c.lineTo(b[0], b[1]); c.stroke();
      c.beginPath(); c.moveTo(b[0], b[1]);
      for (const side of [2.7, -2.7]) c.lineTo(b[0] + 9 * Math.cos(turn + side), b[1] + 9 * Math.sin(turn + side));
      c.closePath(); c.fill();
    }
  }

  play.addEventListener("click", function () { if (playing) stop(); else start(); });
  seek.addEventListener("input", function () { stop(); go(Number(seek.value) / 1000); });
  part("drop").addEventListener("change", function (event) { stop(); choose(Number(event.target.value)); });
  part("ghost").addEventListener("change", draw);
  window.addEventListener("resize", draw);
  stop();
  choose(Number(part("drop").value));
})();
