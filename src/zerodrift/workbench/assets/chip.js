"use strict";
// The firmware's own C in the page: replays a run in a worker, step by step beside the reference's answer.
(function () {
  const most = 65536, shownLive = 600;
  let told = null, worker = null, run = null, live = null, playing = false, busy = false, due = 0, last = 0, asked = 0;
  const waiting = new Map();
  const find = (name) => document.getElementById("chip-" + name);
  function make(tag, options, ...parts) {
    const { style, ...rest } = options || {};
    const made = Object.assign(document.createElement(tag), rest);
    made.append(...parts);
    return made;
  }
  function ask(what, options, moved) {
    return new Promise((resolve, reject) => {
      waiting.set(++asked, { resolve, reject });
      worker.postMessage({ what, id: asked, ...options }, moved || []);
    });
  }
  function say(words, isWrong) {
    const place = find("says");
    place.textContent = words;
    place.classList.toggle("wrong", Boolean(isWrong));
  }
  // --- the parts ----------------------------------------------------------------------------------
  function build() {
    const choose = (words, name) => make("label", { className: "wide" }, words, make("select", { id: "chip-" + name }));
    const button = (words, name) => make("button", { id: "chip-" + name, type: "button" }, words);
    const slide = (words, name) => make("label", { className: "wide" }, words + " ", make("span", { id: "chip-" + name + "-told", className: "told" }),
      make("input", { id: "chip-" + name, type: "range", min: 0, max: name === "speed" ? 24 : 1, step: 1 }));
    const tile = (name, words) => make("div", { className: "tile" }, make("b", { id: "chip-" + name }, "–"), make("span", { id: "chip-" + name + "-words" }, words));
    const buttons = [button("Play", "play"), button("From the start", "again")];
    if ("serial" in navigator) {
      buttons.push(button("Feed a live sensor", "live"),
        make("label", {}, "baud ", make("input", { id: "chip-baud", type: "number", value: 115200, min: 300, max: 4000000 })));
    }
    document.getElementById("chip").replaceChildren(
      make("div", { className: "choices chip" }, choose("Run", "run"), choose("Output", "output"), slide("Speed:", "speed"), slide("Position:", "position")),
      make("div", { className: "actions" }, ...buttons),
      make("p", { id: "chip-says", role: "status" }),
      make("div", { className: "tiles" }, tile("steps", "steps by the C"), tile("differ", "difference from the reference"),
        tile("drift", "drift"), tile("compensated", "compensated"), tile("flags", "flags")),
      make("figure", { id: "chip-figure" }, make("div", { id: "chip-plot" }), make("figcaption", { id: "chip-key" })));
    find("run").replaceChildren(...told.runs.map((one, number) => new Option(one.name + (one.held_out ? "" : " (learnt from)"), number)));
    find("output").replaceChildren(...told.outputs.map((one, number) => new Option(one.name, number)));
    find("speed").value = 12;
  }
  async function open(text) {
    close();
    const place = document.getElementById("chip");
    if (!text) { told = null; place.replaceChildren(); return; }
    told = JSON.parse(text);
    build();
    worker = new Worker("/assets/chip_worker.js?at=" + told.at);
    worker.onmessage = ({ data }) => {
      const one = waiting.get(data.id);
      waiting.delete(data.id);
      if (data.error) { one.reject(new Error(data.error)); } else { one.resolve(data); }
    };
    worker.onerror = () => say("The worker that runs the C did not start.", true);
    try {
      const wasm = await (await fetch("/chip/wasm?at=" + told.at)).arrayBuffer();
      const opened = await ask("open", { wasm, columns: told.columns, outputs: told.outputs.length, code_bytes: told.code_bytes });
      told.ready = "The C of " + told.prefix + " runs here: " + told.wasm_bytes + " B of WebAssembly, state " + opened.state_bytes +
        " B; self-test " + (opened.fault ? "FAILED (" + opened.fault + ")" : "passed") + ".";
      busy = true; // nothing can be pressed before the run is here
      await load().finally(() => { busy = false; });
      show();
      say(told.ready, opened.fault);
    } catch (error) { say(String(error.message || error), true); }
  }
  function close() {
    stopLive();
    playing = false;
    worker?.terminate();
    worker = run = null;
    busy = false;
    waiting.clear();
  }
  async function load() {
    const number = Number(find("run").value), own = told.runs[number], k = told.outputs.length, n = own.steps;
    const content = await (await fetch("/chip/run?at=" + told.at + "&number=" + number)).arrayBuffer();
    let at = 0;
    const take = (bytes) => content.slice(at, at += bytes);
    run = { ...own, measured: new Float64Array(take(8 * n * k)), drift: new Int32Array(take(4 * n * k)), flags: new Uint32Array(take(4 * n)),
      codes: take(n * told.columns * told.code_bytes) };
    find("position").max = n;
    await start();
  }
  async function start() {
    const k = told.outputs.length;
    run.done = run.differ = run.largest = run.milliseconds = 0;
    run.first = null;
    run.answers = new Int32Array(run.steps * k);
    run.raised = new Uint32Array(run.steps);
    if (run.codes.byteLength) { await ask("start", { codes: run.codes.slice(0, told.columns * told.code_bytes), settled: true, elapsed: run.elapsed || 0 }); }
    show();
  }
  // --- steps ----------------------------------------------------------------------------------------
  async function step(count) {
    const width = told.columns * told.code_bytes, k = told.outputs.length, of = run;
    const first = of.done, stop = Math.min(first + count, of.steps), codes = of.codes.slice(first * width, stop * width);
    const found = await ask("run", { codes, chunk: 0 }, [codes]);
    if (of !== run) { return; }
    run.answers.set(found.drift, first * k);
    run.raised.set(found.flags, first);
    for (let row = first; row < stop; row++) {
      let off = found.flags[row - first] === run.flags[row] ? 0 : 1;
      for (let one = 0; one < k; one++) {
        const by = Math.abs(found.drift[(row - first) * k + one] - run.drift[row * k + one]);
        if (by) { off = 1; run.largest = Math.max(run.largest, by); }
      }
      if (off) { run.differ++; run.first = run.first ?? row; }
    }
    run.done = stop;
    run.milliseconds += found.milliseconds;
  }
  async function guarded(work) {
    if (busy || !run) { return; }
    busy = true;
    try { await work(); } catch (error) { playing = false; say(String(error.message || error), true); }
    busy = false;
    show();
  }
  async function go(position) {
    await start();
    while (run.done < position) { await step(Math.min(most, position - run.done)); }
  }
  function rate() { return 10 ** (Number(find("speed").value) / 4); }
  function frame(now) {
    if (!playing || !run) { return; }
    due = Math.min(due + rate() * Math.min((now - last) / 1000, 0.25), most * 4);
    last = now;
    if (due >= 1 && !busy) {
      const count = Math.floor(due);
      due -= count;
      guarded(async () => {
        await step(count);
        if (run.done >= run.steps) { playing = false; }
      });
    }
    requestAnimationFrame(frame);
  }
  function play() {
    if (live) { return; }
    if (playing) { playing = false; show(); return; }
    const from = run.done >= run.steps ? guarded(start) : Promise.resolve();
    from.then(() => { playing = true; due = 0; last = performance.now(); requestAnimationFrame(frame); show(); });
  }
  // --- a live sensor -----------------------------------------------------------------------------------
  function append(came) {
    const k = told.outputs.length, rows = came.codes.length, old = run;
    const grow = (kind, before, values, per) => {
      const made = new kind(before.length + rows * per);
      made.set(before);
      made.set(values, before.length);
      return made;
    };
    const kind = { 2: Int16Array, 4: Int32Array, 8: BigInt64Array }[told.code_bytes];
    const codes = came.codes.flat();
    old.codes = grow(kind, new kind(old.codes), told.code_bytes === 8 ? codes.map(BigInt) : codes, told.columns).buffer;
    old.drift = grow(Int32Array, old.drift, came.drift.flat(), k);
    old.flags = grow(Uint32Array, old.flags, came.flags, 1);
    old.measured = grow(Float64Array, old.measured, came.measured.flat().map((x) => x ?? NaN), k);
    old.answers = grow(Int32Array, old.answers, [], k);
    old.raised = grow(Uint32Array, old.raised, [], 1);
    old.steps += rows;
  }
  async function feed(text, isFirst) {
    const answer = await fetch("/chip/lines" + (isFirst ? "?anew=1" : ""), { method: "POST", body: text });
    const came = await answer.json();
    if (!answer.ok) { throw new Error(came.error); }
    if (came.codes.length) {
      const isNew = run.steps === 0;
      append(came);
      if (isNew) { await ask("start", { codes: run.codes.slice(0, told.columns * told.code_bytes), settled: true, elapsed: 0 }); }
      while (run.done < run.steps) { await step(most); }
    }
    const strays = came.strays ? " " + came.strays + " lines were no rows; the first: " + came.first_stray + "." : "";
    const sampling = came.sampling ? " " + came.sampling[0].toUpperCase() + came.sampling.slice(1) + "." : "";
    say("Live: " + run.steps + " steps." + sampling + strays, came.strays > 0 || came.warns);
    show();
  }
  async function startLive() {
    const port = await navigator.serial.requestPort();
    await port.open({ baudRate: Number(find("baud").value) || 115200 });
    playing = false;
    const k = told.outputs.length;
    live = { port, reader: port.readable.getReader() };
    run = { name: "live", steps: 0, elapsed: 0, codes: new ArrayBuffer(0), drift: new Int32Array(0), flags: new Uint32Array(0),
      measured: new Float64Array(0), live: true };
    await start();
    say("Live: waiting for lines with " + told.reads.join(", ") + ".");
    const decoder = new TextDecoder();
    let rest = "", isFirst = true;
    const own = live;
    try {
      while (live === own) {
        const { value, done } = await own.reader.read();
        if (done) { break; }
        rest += decoder.decode(value, { stream: true });
        const end = rest.lastIndexOf("\n");
        if (end >= 0 && live === own) {
          const text = rest.slice(0, end + 1);
          rest = rest.slice(end + 1);
          await feed(text, isFirst);
          isFirst = false;
        }
      }
    } catch (error) { say(String(error.message || error), true); }
    if (live === own) { stopLive(); show(); }
  }
  function stopLive() {
    const own = live;
    live = null;
    own?.reader.cancel().catch(() => {}).then(() => { own.reader.releaseLock(); return own.port.close(); }).catch(() => {});
  }
  // --- what is shown --------------------------------------------------------------------------------------
  function write(value) { return Number.isFinite(value) ? String(Number(value.toPrecision(6))) : "–"; }
  function group(count) { return count.toLocaleString("en"); }
  function show() {
    if (!run || !find("steps")) { return; }
    const k = told.outputs.length, one = Number(find("output").value) || 0, output = told.outputs[one], at = run.done - 1;
    const drift = at < 0 ? NaN : run.answers[at * k + one] / output.lsb_per_unit;
    const measured = at < 0 ? NaN : run.measured[at * k + one];
    find("steps").textContent = group(run.done);
    const speed = run.milliseconds > 20 ? ", " + (run.done / run.milliseconds / 1000).toPrecision(2) + " million a second" : "";
    find("steps-words").textContent = "of " + group(run.steps) + " steps by the C" + speed;
    find("differ").textContent = run.differ ? "DIFFERENT" : "0 LSB";
    find("differ").classList.toggle("wrong", run.differ > 0);
    find("differ-words").textContent = run.differ
      ? group(run.differ) + (run.differ === 1 ? " step differs" : " steps differ") + ", by up to " + group(run.largest) + " LSB; the first is step " + group(run.first)
      : "from the reference, in " + group(run.done) + " of " + group(run.done) + " steps";
    find("drift").textContent = write(drift);
    find("drift-words").textContent = "drift of " + output.name + ", " + output.unit;
    find("compensated").textContent = write(measured - drift);
    find("compensated-words").textContent = "compensated, " + output.unit + "; measured " + write(measured);
    const raised = at < 0 ? 0 : run.raised[at];
    const words = told.flags.filter((flag) => raised & flag.bit).map((flag) => flag.words);
    find("flags").textContent = at < 0 ? "–" : String(raised);
    find("flags-words").textContent = at < 0 ? "flags" : words.join(", ") || "no flag: all is well";
    find("position").max = run.steps;
    find("play").textContent = playing ? "Pause" : "Play";
    for (const name of ["play", "again", "run", "position"]) { find(name).disabled = Boolean(live); }
    if (find("live")) { find("live").textContent = live ? "End the live sensor" : "Feed a live sensor"; }
    if (document.activeElement !== find("position") || playing) { find("position").value = run.done; }
    tellSliders();
    draw(one, output);
  }
  function tellSliders() {
    const now = rate(), position = Number(find("position").value);
    find("speed-told").textContent = (now < 10 ? now.toFixed(1) : group(Math.round(now))) + " steps a second";
    const minutes = position * told.period_s / 60;
    find("position-told").textContent = group(position) + (minutes < 1e6 ? " (" + minutes.toFixed(1) + " min)" : "");
    find("speed").setAttribute("aria-valuetext", find("speed-told").textContent);
    find("position").setAttribute("aria-valuetext", find("position-told").textContent);
  }
  const SVG = "http://www.w3.org/2000/svg";
  const shape = (tag, options) => { const made = document.createElementNS(SVG, tag); Object.entries(options).forEach(([name, value]) => made.setAttribute(name, value)); return made; };
  // The highest and lowest of each pixel, so that no peak is lost.
  function trace(value, from, to, xOf, yOf) {
    let path = "", pixel = null, low = 0, high = 0, isOpen = false;
    const flush = () => {
      if (pixel === null) { return; }
      path += (isOpen ? "L" : "M") + pixel + " " + yOf(low).toFixed(1) + (high > low ? "L" + pixel + " " + yOf(high).toFixed(1) : "");
      isOpen = true;
      pixel = null;
    };
    for (let row = from; row < to; row++) {
      const y = value(row);
      if (!Number.isFinite(y)) { flush(); isOpen = false; continue; }
      const x = Math.round(xOf(row));
      if (x !== pixel) { flush(); pixel = x; low = high = y; } else { low = Math.min(low, y); high = Math.max(high, y); }
    }
    flush();
    return path;
  }
  function draw(one, output) {
    const place = find("plot"), width = Math.max(place.clientWidth, 240), height = 240, left = 64, bottom = 26, top = 10;
    const k = told.outputs.length, lsb = output.lsb_per_unit, from = run.live ? Math.max(0, run.done - shownLive) : 0;
    const to = run.live ? Math.max(run.done, 2) : run.steps;
    const own = (row) => run.answers[row * k + one] / lsb, wanted = (row) => run.drift[row * k + one] / lsb;
    const measured = (row) => run.measured[row * k + one], left_ = (row) => measured(row) - own(row);
    let low = Infinity, high = -Infinity;
    for (let row = from; row < Math.min(to, run.steps); row++) {
      const d = wanted(row), m = measured(row);
      low = Math.min(low, d); high = Math.max(high, d);
      if (Number.isFinite(m)) { low = Math.min(low, m, m - d); high = Math.max(high, m, m - d); }
    }
    if (!(high > low)) { const middle = Number.isFinite(low) ? low : 0; low = middle - 1; high = middle + 1; }
    const xOf = (row) => left + (row - from) / Math.max(to - 1 - from, 1) * (width - left - 8);
    const yOf = (y) => top + (high - y) / (high - low) * (height - top - bottom);
    const svg = shape("svg", { width, height, viewBox: "0 0 " + width + " " + height, role: "img",
      "aria-label": "Measured, compensated and drift of " + output.name + " over " + run.done + " steps; " + (run.differ ? "the C differs from the reference" : "the C equals the reference") });
    const rough = (high - low) / 5, decade = 10 ** Math.floor(Math.log10(rough));
    const apart = decade * [1, 2, 5, 10].find((times) => times * decade >= rough);
    for (let tick = Math.ceil(low / apart); tick <= high / apart; tick++) {
      const y = tick * apart, at = yOf(y);
      svg.append(shape("path", { d: "M" + left + " " + at + "H" + (width - 8), class: "grid" }));
      const text = shape("text", { x: left - 6, y: at + 4, "text-anchor": "end" });
      text.textContent = String(Number(y.toPrecision(6)));
      svg.append(text);
    }
    [0, 0.5, 1].forEach((share) => {
      const row = from + share * (to - 1 - from);
      const text = shape("text", { x: xOf(row), y: height - 8, "text-anchor": share === 0 ? "start" : share === 1 ? "end" : "middle" });
      text.textContent = group(Math.round(row + 1)) + (share === 1 ? " steps" : "");
      svg.append(text);
    });
    const line = (name, value, end) => svg.append(shape("path", { d: trace(value, from, end, xOf, yOf) || "M0 0", class: name }));
    line("measured", measured, run.done);
    line("reference", wanted, Math.min(to, run.steps));
    line("compensated", left_, run.done);
    line("own", own, run.done);
    if (run.done > 0) { svg.append(shape("path", { d: "M" + xOf(run.done - 1).toFixed(1) + " " + top + "V" + (height - bottom), class: "here" })); }
    place.replaceChildren(svg);
    if (!find("key").childElementCount || find("key").dataset.of !== output.name) {
      find("key").dataset.of = output.name;
      find("key").replaceChildren(...[["measured", "measured"], ["compensated", "compensated"], ["reference", "drift, the reference's answer"], ["own", "drift, this C"]].map(([name, words]) => {
        const sample = shape("svg", { width: 30, height: 10, "aria-hidden": "true" });
        sample.append(shape("path", { d: "M1 5H29", class: name }));
        return make("span", {}, sample, " " + words + (name === "measured" ? " (" + output.name + ", " + output.unit + ")" : ""));
      }));
    }
  }
  // --- what the user does ----------------------------------------------------------------------------------
  document.addEventListener("click", (event) => {
    if (!run) { return; }
    if (event.target.id === "chip-play") { play(); }
    if (event.target.id === "chip-again") { playing = false; guarded(start); }
    if (event.target.id === "chip-live") {
      if (live) { stopLive(); show(); } else { startLive().catch((error) => say(String(error.message || error), error.name !== "NotFoundError")); }
    }
  });
  document.addEventListener("input", (event) => {
    if (run && /^chip-(speed|position)$/.test(event.target.id)) {
      if (event.target.id === "chip-position") { playing = false; }
      tellSliders();
    }
  });
  document.addEventListener("change", (event) => {
    if (!run) { return; }
    if (event.target.id === "chip-run") { playing = false; guarded(load); }
    if (event.target.id === "chip-output") { show(); }
    if (event.target.id === "chip-position") {
      const wanted = Number(event.target.value), wait = () => (busy ? setTimeout(wait, 20) : guarded(() => go(wanted)));
      wait();
    }
  });
  let timer = null;
  window.addEventListener("resize", () => { clearTimeout(timer); timer = setTimeout(show, 150); });
  let known = "";
  new MutationObserver(() => {
    const text = document.getElementById("chip")?.dataset.chip || "";
    if (text !== known) { known = text; open(text); }
  }).observe(document.documentElement, { childList: true, subtree: true, attributes: true, attributeFilter: ["data-chip"] });
})();
