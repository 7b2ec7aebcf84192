"use strict";
// The cause picture: asked of the server, which draws it; here it is only put in place, read by a
// cursor, and marked. What is chosen lives here.
(function () {
  const SVG = "http://www.w3.org/2000/svg";
  const wish = { output: null, run: null, effect: null, panes: [], against: "", from_s: null, to_s: null };
  const zd = (window.zd = window.zd || {});
  let now = null, mark = null, cursor = null, picked = null, drag = null;
  let isTold = false, busy = false, waiting = false, early = window.zdFirst || null;
  const moves = [];
  const place = () => document.getElementById("main");
  function room() {
    const width = place() ? place().clientWidth : 0;
    return Math.max(width, 240);
  }
  async function request(move) {
    const told = Object.assign({}, wish, { move: move || "", width: room() });
    const answer = await fetch("/picture?wish=" + encodeURIComponent(JSON.stringify(told)) + (isTold ? "&told=1" : ""));
    return answer.ok ? answer.json() : null;
  }
  async function ask() {
    if (!place()) { return; }
    if (busy) { waiting = true; return; }
    busy = true;
    try {
      do {
        waiting = false;
        let told = null;
        if (!place().clientWidth) { setTimeout(ask, 60); break; } // still hidden: of no width yet
        if (early) {
          told = await early;
          early = null;
          const is_fit = told && !told.waiting && Math.abs(told.cause.picture.width - room()) < 3;
          const is_plain = !moves.length && !wish.output && wish.from_s === null;
          if (!is_fit || !is_plain) { told = null; }
        }
        told = told || (await request(moves.shift()));
        if (told?.waiting) { wait(told); } else if (told) { draw(told); }
      } while (waiting || moves.length);
    } catch (error) { zd.lost?.(); } finally { busy = false; }
  }
  zd.ask = ask;
  // Nothing is found yet: the frame of the chart, of its size, with what one log shows.
  function wait(told) {
    now = null;
    const sketch = document.createElement("div");
    sketch.className = "sketch";
    sketch.innerHTML = told.svg;
    place().replaceChildren(sketch);
    place().style.minHeight = told.height + "px";
    if (!told.is_drawn) { setTimeout(ask, 300); }
  }
  zd.wish = function (more) {
    if (("output" in more && more.output !== wish.output) || ("run" in more && more.run !== wish.run)) {
      const run = "run" in more ? more.run : wish.run;
      if (run !== wish.run) { wish.from_s = wish.to_s = null; mark = null; }
      picked = null;
    }
    if ("effect" in more && more.effect !== wish.effect) { wish.panes = []; wish.against = ""; }
    Object.assign(wish, more);
    ask();
  };
  zd.go = function (part) {
    Object.assign(wish, { output: part.output, run: part.run, from_s: part.from_s, to_s: part.to_s });
    mark = [part.mark_from_s, part.mark_to_s];
    ask();
  };
  function element(name, attributes, parent) {
    const made = document.createElementNS(SVG, name);
    Object.entries(attributes).forEach(([key, value]) => made.setAttribute(key, value));
    if (parent) { parent.append(made); }
    return made;
  }
  function draw(told) {
    now = told;
    cursor = picked = null;
    wish.from_s = told.is_whole ? null : told.cause.from_s;
    wish.to_s = told.is_whole ? null : told.cause.to_s;
    const main = place();
    let sheet = main.querySelector(".sheet");
    if (!sheet) {
      sheet = document.createElement("div");
      sheet.className = "sheet";
      const heads = document.createElement("div");
      heads.className = "heads";
      const readout = document.createElement("div");
      readout.className = "readout";
      readout.hidden = true;
      main.replaceChildren(sheet, heads, readout);
    }
    sheet.innerHTML = told.svg;
    element("g", { class: "over" }, sheet.firstChild);
    main.style.minHeight = told.cause.picture.height + "px";
    offerPanes(told);
    offerAgainst(told);
    zd.fillTable?.(document.getElementById("main-table"), told.sheet);
    mend();
    main.dataset.drawn = told.shown + " " + told.run + " " + told.output + " " + told.effect + " " +
      told.cause.from_s + " " + told.cause.to_s;
  }
  function fillList(list, choices, chosen) {
    const text = JSON.stringify(choices);
    if (list.dataset.known !== text) {
      list.replaceChildren(...choices.map((one) => new Option(one.words, one.key)));
      list.dataset.known = text;
    }
    if (!choices.some((one) => one.key === chosen)) { list.append(new Option(chosen, chosen)); }
    list.value = chosen;
  }
  function offerPanes(told) {
    const heads = place().querySelector(".heads");
    told.cause.panes.forEach((pane, number) => {
      let list = heads.children[number];
      if (!list) {
        list = document.createElement("select");
        list.className = "head";
        list.setAttribute("aria-label", "Pane " + (number + 1));
        list.addEventListener("change", () => {
          wish.panes = Array.from(heads.children).filter((e) => !e.hidden).map((one) => one.value);
          ask();
        });
        heads.append(list);
      }
      list.hidden = false;
      fillList(list, told.panes, pane.key);
      const isNarrow = told.cause.width < 560;
      list.style.left = told.cause.left - 4 + "px";
      list.style.top = pane.top - (isNarrow ? 42 : 24) + "px";
    });
    Array.from(heads.children).slice(told.cause.panes.length).forEach((list) => { list.hidden = true; });
  }
  function offerAgainst(told) {
    const list = document.getElementById("against");
    if (list) { fillList(list, told.drivers, told.against); }
  }
  // --- places ------------------------------------------------------------------------------------
  const xOf = (s) => now.cause.left + (now.cause.width * (s - now.cause.from_s)) / (now.cause.to_s - now.cause.from_s);
  const sOf = (x) => now.cause.from_s + ((now.cause.to_s - now.cause.from_s) * (x - now.cause.left)) / now.cause.width;
  function dotOf(row) {
    const box = now.cause.scatter, y = now.cause.curves[leftCurve()].values[row];
    const share = (value, ends) => (value - ends[0]) / (ends[1] - ends[0]);
    return [box.left + box.width * share(box.against[row], box.x), box.top + box.height * (1 - share(y, box.y))];
  }
  function leftCurve() {
    return now.cause.curves.findIndex((curve) => curve.name === "what is left");
  }
  function hit(event) {
    const box = place().querySelector("svg").getBoundingClientRect();
    const x = event.clientX - box.left, y = event.clientY - box.top;
    const bottom = now.cause.panes.length ? now.cause.panes.at(-1).top + now.cause.panes.at(-1).height : 0;
    const inTime = x >= now.cause.left && x <= now.cause.left + now.cause.width && y > 0 && y <= bottom + 6;
    const cloud = now.cause.scatter;
    const inCloud = x >= cloud.left && x <= cloud.left + cloud.width && y >= cloud.top && y <= cloud.top + cloud.height;
    return { x, y, area: inCloud ? "cloud" : inTime ? "time" : "" };
  }
  function nearest(s) {
    const times = now.cause.times_s;
    let low = 0, high = times.length - 1;
    while (high - low > 1) {
      const middle = (low + high) >> 1;
      if (times[middle] <= s) { low = middle; } else { high = middle; }
    }
    return s - times[low] <= times[high] - s ? low : high;
  }
  // --- what is marked, and what the cursor reads ---------------------------------------------------
  function mend() {
    const over = place()?.querySelector("svg .over");
    if (!over || !now) { return; }
    over.replaceChildren();
    const panes = now.cause.panes, first = panes[0], last = panes.at(-1);
    const upright = `M0 ${first.top}V${last.top + last.height}`;
    if (mark) {
      const ends = mark.map((s) => Math.min(Math.max(xOf(s), now.cause.left), now.cause.left + now.cause.width));
      panes.forEach((pane) => element("rect", {
        class: "mark", x: ends[0], y: pane.top, width: Math.max(ends[1] - ends[0], 1), height: pane.height,
      }, over));
    }
    const rows = picked || (mark ? now.cause.times_s.map((s, row) => (s >= mark[0] && s <= mark[1] ? row : -1)).filter((r) => r >= 0) : []);
    if (rows.length && leftCurve() >= 0) {
      const path = rows.map((row) => { const [x, y] = dotOf(row); return `M${x.toFixed(1)} ${y.toFixed(1)}h0`; }).join("");
      element("path", { class: "lit", d: path }, over);
      if (picked) {
        const lines = rows.map((row) => panes.map((p) => `M${xOf(now.cause.times_s[row]).toFixed(1)} ${p.top}v${p.height}`).join("")).join("");
        element("path", { class: "lines", d: lines }, over);
      }
    }
    if (drag?.box) { element("rect", Object.assign({ class: "mark" }, drag.box), over); }
    if (cursor !== null) {
      const x = xOf(now.cause.times_s[cursor]);
      element("path", { class: "cursor", d: upright, transform: `translate(${x})` }, over);
      if (leftCurve() >= 0) {
        const [a, b] = dotOf(cursor);
        element("circle", { class: "cursor", cx: a, cy: b, r: 5 }, over);
      }
    }
    read();
    const button = document.getElementById("to-mark");
    if (button) { button.disabled = !mark; }
  }
  function write(value) {
    return (Math.abs(value) >= 1e5 || (value !== 0 && Math.abs(value) < 1e-4) ? value.toExponential(3) : String(Number(value.toPrecision(5)))).replace("-", "−");
  }
  function read() {
    const readout = place().querySelector(".readout");
    readout.hidden = cursor === null;
    if (cursor === null) { return; }
    const table = document.createElement("table");
    const s = now.cause.times_s[cursor];
    const rows = [["time", write((s - now.from_s) / now.seconds) + " " + now.clock], ...now.cause.curves.map((curve) => [curve.name, write(curve.values[cursor]) + " " + curve.unit])];
    rows.forEach(([name, value]) => {
      const row = table.insertRow();
      row.insertCell().textContent = name;
      row.insertCell().textContent = value;
    });
    readout.replaceChildren(table);
    const x = xOf(s), wide = place().clientWidth;
    readout.style.left = (x + 14 + readout.offsetWidth > wide ? Math.max(x - 14 - readout.offsetWidth, 0) : x + 14) + "px";
    readout.style.top = (now.cause.panes[1] || now.cause.panes[0]).top + 24 + "px";
  }
  // --- pointer and keyboard ------------------------------------------------------------------------
  document.addEventListener("pointermove", (event) => {
    if (!now || !place()?.querySelector("svg")) { return; }
    if (drag) { follow(event); return; }
    if (!event.target.closest("#main")) {
      if (cursor !== null && document.activeElement !== place()) { cursor = null; mend(); }
      return;
    }
    const at = hit(event);
    const row = at.area === "time" ? nearest(sOf(at.x)) : at.area === "cloud" ? nearestDot(at) : null;
    if (row !== cursor) { cursor = row; mend(); }
  });
  function nearestDot(at) {
    if (leftCurve() < 0) { return null; }
    let best = null, least = 400;
    now.cause.times_s.forEach((_, row) => {
      const [x, y] = dotOf(row), far = (x - at.x) ** 2 + (y - at.y) ** 2;
      if (far < least) { least = far; best = row; }
    });
    return best;
  }
  document.addEventListener("pointerdown", (event) => {
    if (!now || event.button !== 0 || !event.target.closest("#main .sheet")) { return; }
    const at = hit(event);
    if (at.area) { drag = { area: at.area, x: at.x, y: at.y, box: null }; }
  });
  function follow(event) {
    const at = hit(event);
    if (Math.abs(at.x - drag.x) + Math.abs(at.y - drag.y) < 5 && !drag.box) { return; }
    cursor = null;
    if (drag.area === "time") {
      picked = null;
      const ends = [drag.x, at.x].map((x) => Math.min(Math.max(x, now.cause.left), now.cause.left + now.cause.width));
      mark = ends.map(sOf).sort((a, b) => a - b);
      drag.box = { width: 0, height: 0 };
    } else {
      mark = null;
      drag.box = { x: Math.min(drag.x, at.x), y: Math.min(drag.y, at.y), width: Math.abs(at.x - drag.x), height: Math.abs(at.y - drag.y) };
      picked = now.cause.times_s.map((_, row) => row).filter((row) => {
        const [x, y] = dotOf(row);
        return x >= drag.box.x && x <= drag.box.x + drag.box.width && y >= drag.box.y && y <= drag.box.y + drag.box.height;
      });
    }
    mend();
  }
  document.addEventListener("pointerup", () => {
    if (drag && !drag.box) { mark = picked = null; mend(); }
    if (drag) { drag = null; mend(); }
  });
  document.addEventListener("dblclick", (event) => {
    if (event.target.closest("#main .sheet")) { mark = null; move("whole"); }
  });
  function move(name) { moves.push(name); ask(); }
  function zoom() {
    if (!mark) { return; }
    Object.assign(wish, { from_s: mark[0], to_s: mark[1] });
    mark = null; // all that is shown from now on; its colour would lie over everything
    ask();
  }
  document.addEventListener("keydown", (event) => {
    if (!now || document.activeElement !== place()) { return; }
    const last = now.cause.times_s.length - 1, steps = { ArrowLeft: -1, ArrowRight: 1, PageUp: -25, PageDown: 25 };
    if (event.key in steps) {
      event.preventDefault();
      const before = cursor === null ? last >> 1 : cursor;
      cursor = Math.min(Math.max(before + steps[event.key], 0), last);
      if (event.shiftKey) {
        const from = now.cause.times_s[before], to = now.cause.times_s[cursor];
        const fixed = mark && Math.abs(mark[1] - from) < Math.abs(mark[0] - from) ? mark[0] : mark ? mark[1] : from;
        mark = [Math.min(fixed, to), Math.max(fixed, to)];
      }
      mend();
    } else if (event.key === "Enter") { zoom(); } else if (event.key === "Escape") { mark = picked = cursor = null; mend(); }
  });
  document.addEventListener("click", (event) => {
    const mover = event.target.closest("[data-move]");
    if (mover) { move(mover.dataset.move); }
    if (event.target.id === "to-mark") { zoom(); }
    if (event.target.id === "tell") { isTold = true; ask(); }
  });
  document.addEventListener("change", (event) => {
    if (event.target.id === "against") { wish.against = event.target.value; ask(); }
  });
  let timer = null;
  window.addEventListener("resize", () => {
    clearTimeout(timer);
    timer = setTimeout(() => {
      const is_other = now ? Math.abs(now.cause.picture.width - room()) > 2 : place()?.dataset.shown;
      if (is_other) { ask(); }
    }, 150);
  });
  new MutationObserver((changes) => {
    if (changes.some((one) => one.type === "attributes" ? one.target.id === "main" : Array.from(one.addedNodes).some((n) => n.nodeType === 1 && (n.id === "main" || n.querySelector("#main"))))) {
      if (place()?.dataset.shown) { ask(); }
    }
  }).observe(document.documentElement, { childList: true, subtree: true, attributes: true, attributeFilter: ["data-shown"] });
})();
