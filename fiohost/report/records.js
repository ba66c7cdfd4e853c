"use strict";
// Records of a report: measured and simulated, the errors before and after as bands, the duty. Zoomed far enough in,
// the band becomes the error itself. One record's panels zoom and point together; the lowest has the axis of time.
(() => {
  const PIXELS_A_PIECE = 3, FINE = 4;  // a band's piece is so wide; with fewer samples a piece the line itself is drawn
  const AXIS = 46;  // pixels that the axis of time takes
  const shown = [];

  function banded(values, pieces) {  // the least, mean and greatest around every sample, in pieces
    const n = values.length, size = Math.max(1, Math.ceil(n / pieces));
    const low = new Array(n), mean = new Array(n), high = new Array(n);
    for (let from = 0; from < n; from += size) {
      const to = Math.min(n, from + size);
      let least = Infinity, most = -Infinity, sum = 0;
      for (let i = from; i < to; i++) { least = Math.min(least, values[i]); most = Math.max(most, values[i]); sum += values[i]; }
      for (let i = from; i < to; i++) { low[i] = least; high[i] = most; mean[i] = sum / (to - from); }
    }
    return [low, mean, high];
  }
  const text = v => Number(v.toPrecision(5)).toString(), texts = (u, all) => all.map(v => Number(v.toPrecision(9)).toString());
  const read = unit => (u, v) => v == null ? "–" : text(v) + " " + unit;
  const line = (label, stroke, unit, more) => Object.assign({label, stroke, width: 1.4, points: {show: false}, value: read(unit)}, more);
  const edge = {label: "", stroke: "transparent", width: 0, points: {show: false}};

  // *silent*: numbers of the series that have no place in the legend; *last*: whether the axis of time is below
  function room(parent, height, label, series, data, key, silent, first, last, extra) {
    const time = last ? {label: "time (s)", size: 28, labelSize: 18, values: texts} : {size: 6, values: (u, all) => all.map(() => "")};
    const options = Object.assign({
      width: parent.clientWidth, height: height + (last ? AXIS : 6), cursor: {sync: {key}, drag: {x: true, y: false}},
      scales: {x: {time: false}}, axes: [time, {label, size: 58, labelSize: 20, space: 20, values: texts}],
      series: [{label: "time", value: read("s")}].concat(series),
    }, extra);
    const plot = new uPlot(options, data, parent), rows = plot.root.querySelectorAll(".u-legend .u-series");
    for (const row of first ? silent : [0].concat(silent)) rows[row].style.display = "none";
    uPlot.sync(key).sub(plot);
    return plot;
  }

  function draw(element, record, name) {
    const t = record.time, models = [["before", "#D55E00", [6, 3]], ["after", "#0072B2", []]].filter(m => record[m[0]]);
    const plots = [];
    let busy = false;
    const follow = {setScale: [(u, key) => {
      const {min, max} = u.scales.x;
      if (key !== "x" || busy || min == null) return;
      busy = true;
      for (const other of plots) { if (other !== u) other.setScale("x", {min, max}); }
      for (const other of plots) if (other.errors) detail(other, min, max);
      busy = false;
    }]};
    function detail(plot, min, max) {
      const inside = t.filter(x => x >= min && x <= max).length, fine = inside < FINE * plot.width / PIXELS_A_PIECE;
      if (plot.fine === fine) return;
      plot.fine = fine;
      const edges = fine ? [plot.errors, plot.errors] : [plot.pieces[0], plot.pieces[2]];
      plot.setData([t, edges[0], fine ? plot.errors : plot.pieces[1], edges[1]].concat(plot.floors), false);
      plot.setScale("x", {min, max});
    }
    const whole = !record.duty && !models.length;
    plots.push(room(element, 260, record.label, [line("measured", "#B4B4B4", record.unit, {width: 5})].concat(
      models.map(m => line("simulated " + m[0], m[1], record.unit, {dash: m[2]}))),
      [t, record.measured].concat(models.map(m => record[m[0]])), name, [], true, whole, {hooks: follow}));
    models.forEach((m, place) => {
      const errors = record.measured.map((y, i) => y - record[m[0]][i]);
      const bands = banded(errors, 900 / PIXELS_A_PIECE), floor = record.floor;
      const floors = floor ? [t.map(() => floor), t.map(() => -floor)] : [];
      const value = (u, v, s, i) => v == null ? "–" : u.fine ? text(v) + " " + record.unit :
        "mean " + text(v) + ", from " + text(u.data[1][i]) + " to " + text(u.data[3][i]) + " " + record.unit;
      const plot = room(element, 150, "error " + m[0] + " (" + record.unit + ")",
        [edge, line("error " + m[0], m[1], record.unit, {width: 1.1, value}), edge].concat(
          floors.map(f => line("floor", "#009E73", record.unit, {dash: [4, 3], width: 1.2}))),
        [t, bands[0], bands[1], bands[2]].concat(floors), name, floor ? [1, 3, 5] : [1, 3], false,
        !record.duty && place === models.length - 1, {bands: [{series: [3, 1], fill: m[1] + "40"}], hooks: follow});
      plot.errors = errors; plot.pieces = bands; plot.floors = floors;
      plots.push(plot);
    });
    if (record.duty) {
      plots.push(room(element, 110, "duty (%)", [line("duty", "#7A7A7A", "%", {paths: uPlot.paths.stepped({align: 1})})],
        [t, record.duty], name, [], false, true, {hooks: follow}));
    }
    for (const plot of plots) {
      plot.over.addEventListener("dblclick", () => plots[0].setScale("x", {min: t[0], max: t[t.length - 1]}));
    }
    shown.push([element, plots]);
  }

  function reveal() {  // what is folded away is drawn when it is unfolded
    for (const element of document.querySelectorAll(".record:not(.drawn)")) {
      if (element.closest("details:not([open])")) continue;
      element.classList.add("drawn");
      draw(element, RECORDS[element.dataset.record], "record" + element.dataset.record);
    }
  }
  for (const fold of document.querySelectorAll("details")) fold.addEventListener("toggle", reveal);
  addEventListener("resize", () => {
    for (const [element, plots] of shown) for (const plot of plots) plot.setSize({width: element.clientWidth, height: plot.height});
  });
  window.drawnRecords = shown;
  reveal();
})();
