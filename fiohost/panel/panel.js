"use strict";
// The panel: asks over the socket, draws what comes. A frame is acknowledged when it is painted, not when it has come.
(() => {
  const byId = id => document.getElementById(id), MOST = 6000, SPEED_OVER_S = 0.2;
  const socket = new WebSocket(location.origin.replace(/^http/, "ws") + "/socket" + location.search);
  const columns = [[], [], [], [], []];  // time, angle, reference, speed, duty
  const rows = [];  // as they came, for export
  let facts = {counts_per_rev: 720, limit_pct: 100, target: "", log: "", sample_time_s: 0.005};
  let paused = false, doing = "hand", recording = false, stopped = false, held = false, last = null;

  const act = (name, value = null) => { if (socket.readyState === 1) socket.send(JSON.stringify({type: "act", name, value})); };
  const numeric = id => { const text = byId(id).value.trim(); return text === "" ? NaN : Number(text); };
  function settings(prefix, numbers, words) {  // null where a number is missing
    const told = {};
    for (const key of words) told[key] = byId(prefix + key).value;
    for (const key of numbers) { told[key] = numeric(prefix + key); byId(prefix + key).setCustomValidity(""); }
    const wrong = numbers.filter(key => !Number.isFinite(told[key]));
    for (const key of wrong) { byId(prefix + key).setCustomValidity("a number"); byId(prefix + key).reportValidity(); }
    return wrong.length ? null : told;
  }
  const source = () => settings("s-", ["amplitude", "offset", "period_s"], ["shape"]);
  function loop() {
    const told = settings("l-", ["kp", "ki", "kd", "amplitude", "offset", "period_s"], ["kind", "shape"]);
    if (told && told.shape === "hold") told.amplitude = 0;
    return told;
  }
  const send = (name, told) => { if (told) act(name, told); };

  for (const name of ["brake", "standby", "reverse", "release"]) byId(name).onclick = () => act(name);
  byId("emergency").onpointerdown = () => act("emergency");  // when it is pressed, not when it is let go
  byId("emergency").onclick = event => { if (event.detail === 0) act("emergency"); };  // by the keyboard
  byId("slider").oninput = () => act("duty", Number(byId("slider").value));
  byId("slider").onpointerdown = () => { held = true; };
  addEventListener("pointerup", () => { held = false; });
  const set = () => { const value = numeric("duty"); if (Number.isFinite(value)) act("duty", value); };
  byId("set").onclick = set;
  byId("duty").onkeydown = event => { if (event.key === "Enter") set(); };
  byId("source").onclick = () => doing === "source" ? act("brake") : send("source", source());
  byId("loop").onclick = () => doing === "loop" ? act("brake") : send("loop", loop());
  for (const input of document.querySelectorAll("[id^=s-]")) input.onchange = () => { if (doing === "source") send("source", source()); };
  for (const input of document.querySelectorAll("[id^=l-]")) input.onchange = () => { if (doing === "loop") send("loop", loop()); };
  byId("record").onclick = () => act("record", !recording);
  byId("pause").onclick = () => pause(!paused);
  byId("span").onchange = () => pause(false);
  byId("all").onclick = () => { pause(true); zoom(columns[0][0], columns[0][columns[0].length - 1]); };
  byId("export").onclick = () => {
    const link = document.createElement("a");
    link.href = URL.createObjectURL(new Blob([csv()], {type: "text/csv"}));
    link.download = "panel.csv";
    link.click();
    setTimeout(() => URL.revokeObjectURL(link.href), 1000);
  };
  function csv() {  // a log of what is shown: readings some 20 ms apart
    const head = ["# schema: fiohost.log/1", "# target: " + facts.target, "# experiment: panel, as shown",
      "# sample_time_s: " + (facts.reading_s || 0.02), "# counts_per_rev: " + facts.counts_per_rev,
      "time_s,duty_pct,c3,c4,pos,direction,ref_deg,angle_deg"];
    const [from, to] = paused ? [plots[0].scales.x.min, plots[0].scales.x.max] : [-Infinity, Infinity];
    const kept = rows.filter(r => r[0] >= from && r[0] <= to);
    return head.concat(kept.map(r => [r[0], r[1], r[2], r[3], r[4], r[5], r[7] == null ? "" : r[7], r[6]].join(","))).join("\n") + "\n";
  }

  const KEYS = {ArrowUp: 1, ArrowDown: -1, PageUp: 10, PageDown: -10}, PLAIN = {" ": "brake", s: "standby", r: "reverse"};
  addEventListener("keydown", event => {
    if (event.key === "Escape") { act("emergency"); return; }
    if (/^(INPUT|SELECT|TEXTAREA)$/.test(event.target.tagName) && event.target.type !== "range") return;
    if (event.key in KEYS) act("change", KEYS[event.key] * (event.shiftKey && Math.abs(KEYS[event.key]) === 1 ? 10 : 1));
    else if (event.key in PLAIN && !(event.repeat)) act(PLAIN[event.key]);
    else return;
    event.preventDefault();
  });

  // ---- charts -------------------------------------------------------------------------------------------------------
  const plots = [];
  let busy = false;
  function pause(wanted) { paused = wanted; byId("pause").textContent = paused ? "Go on" : "Pause"; byId("pause").classList.toggle("on", paused); if (!paused) paint(); }
  function zoom(min, max) { if (min == null || !(max > min)) return; busy = true; for (const p of plots) p.setScale("x", {min, max}); busy = false; }
  const digits = (u, v) => v == null ? "–" : v.toFixed(1);
  const line = (label, stroke, more) => Object.assign({label, stroke, width: 1.5, points: {show: false}, value: digits}, more);
  function chart(label, height, series, range) {
    const room = byId("rooms"), options = {
      width: Math.max(260, room.clientWidth), height, cursor: {sync: {key: "panel"}, drag: {x: true, y: false}},
      scales: {x: {time: false}, y: range ? {range} : {}}, axes: [{size: 34}, {label, size: 56, labelSize: 18}],
      series: [{label: "time (s)", value: digits}].concat(series),
      hooks: {setSelect: [u => { if (u.select.width > 2) { pause(true); const at = x => u.posToVal(x, "x"); zoom(at(u.select.left), at(u.select.left + u.select.width)); } }]},
    };
    const plot = new uPlot(options, [[]].concat(series.map(() => [])), room);
    plot.over.addEventListener("dblclick", () => pause(false));
    plots.push(plot);
  }
  function build() {
    for (const p of plots.splice(0)) p.destroy();
    const narrow = innerWidth < 720, most = 1.08 * facts.limit_pct;
    chart("angle (deg)", narrow ? 170 : 240, [line("angle", "#D55E00"), line("set point", "#7A7A7A", {dash: [5, 4]})]);
    chart("speed (deg/s)", narrow ? 150 : 200, [line("speed", "#0072B2")]);
    chart("duty (%)", narrow ? 130 : 170, [line("duty", "#222", {paths: uPlot.paths.stepped({align: 1})})], () => [-most, most]);
    paint();
  }
  function paint() {
    if (!plots.length) return;
    const [t, angle, ref, speed, duty] = columns;
    busy = true;
    plots[0].setData([t, angle, ref], false); plots[1].setData([t, speed], false); plots[2].setData([t, duty], false);
    busy = false;
    if (!paused && t.length) { const end = t[t.length - 1]; zoom(Math.max(t[0], end - Number(byId("span").value)), Math.max(end, t[0] + 0.1)); }
    else if (t.length) zoom(plots[0].scales.x.min, plots[0].scales.x.max);
  }
  addEventListener("resize", () => { const width = Math.max(260, byId("rooms").clientWidth); for (const p of plots) p.setSize({width, height: p.height}); });

  // ---- what comes ---------------------------------------------------------------------------------------------------
  function take(reading) {
    const [time, duty, c3, c4, pos, direction, angle, ref] = reading;
    let speed = 0;
    for (let i = rows.length - 1; i >= 0; i--) {
      if (time - rows[i][0] > SPEED_OVER_S - 1e-9) { speed = (angle - rows[i][6]) / (time - rows[i][0]); break; }
    }
    rows.push(reading);
    [time, angle, ref == null ? null : ref, speed, duty].forEach((value, i) => columns[i].push(value));
    if (rows.length > MOST) { rows.splice(0, 500); for (const column of columns) column.splice(0, 500); }
    last = {pos, direction, speed, angle};
  }
  function show(news) {
    for (const reading of news.readings) take(reading);
    doing = news.doing; recording = news.recording !== ""; stopped = news.stopped;
    if (news.answered && !held) byId("slider").value = news.duty_pct;
    const bits = {drive: news.duty_pct > 0 ? "1 0" : "0 1", brake: "1 1", standby: "0 0"}[news.mode];
    const words = stopped ? "STOPPED: release to drive again" : `${(Math.round(10 * news.duty_pct) / 10 || 0).toFixed(1)} %  ${news.mode}  C3 C4 = ${bits}`;
    byId("now").firstChild.textContent = words;
    byId("now").lastElementChild.textContent = news.note;
    byId("emergency").classList.toggle("stopped", stopped);
    byId("emergency").innerHTML = stopped ? "STOPPED" : "EMERGENCY<br>STOP";
    byId("release").classList.toggle("on", stopped);
    for (const name of ["brake", "standby"]) byId(name).classList.toggle("on", news.mode === name && doing === "hand" && !stopped);
    for (const name of ["source", "loop"]) { byId(name).textContent = doing === name ? "Stop" : "Start"; byId(name).classList.toggle("on", doing === name); }
    byId("record").textContent = recording ? "Stop recording" : "Record"; byId("record").classList.toggle("on", recording);
    byId("recording").textContent = recording ? `${news.recording}: ${news.recorded} rows` : "";
    byId("status").textContent = `${news.ticks} ticks of ${(1e3 * facts.sample_time_s).toFixed(0)} ms, ${news.late} late, worst ${news.worst_ms.toFixed(1)} ms, ${news.missed} missed`;
    if (last) {
      const shown = (last.pos + 1) * 360 / facts.counts_per_rev;
      byId("angle").textContent = shown.toFixed(1) + "°";
      byId("needle").setAttribute("transform", `rotate(${shown})`);
      byId("pos").textContent = last.pos;
      byId("speed").textContent = `${last.speed.toFixed(0)} deg/s (${(last.speed / 6).toFixed(1)} rpm)`;
      byId("direction").textContent = last.direction ? "1, counting down" : "0, counting up";
    }
    if (!paused) paint();
  }
  socket.onmessage = message => {
    const came = JSON.parse(message.data);
    if (came.type === "facts") {
      facts = Object.assign(facts, came);
      byId("target").textContent = facts.target;
      byId("log").textContent = facts.log ? "log " + facts.log : "no log";
      byId("slider").min = -facts.limit_pct; byId("slider").max = facts.limit_pct;
      build();
    } else if (came.type === "role") {
      byId("watching").style.display = came.drives ? "none" : "block";
    } else if (came.type === "news") {
      show(came);
      requestAnimationFrame(() => requestAnimationFrame(() => { if (socket.readyState === 1) socket.send('{"type": "ack"}'); }));
    }
  };
  socket.onclose = () => { byId("gone").style.display = "block"; };
  window.fiohostPanel = {plots, columns, csv, zoom, isPaused: () => paused};
})();
