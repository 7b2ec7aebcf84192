"use strict";
(function () {
  const root = document.documentElement;
  const dark = window.matchMedia("(prefers-color-scheme: dark)");
  const largest = 1 << 30;
  let chosen = null;
  function theme() {
    root.dataset.theme = chosen || (dark.matches ? "dark" : "light");
    return root.dataset.theme === "dark" ? "Light page" : "Dark page";
  }
  theme();
  dark.addEventListener("change", theme);
  window.dash_clientside = Object.assign({}, window.dash_clientside, {
    zerodrift: {
      turn: function (clicks) {
        if (clicks) { chosen = root.dataset.theme === "dark" ? "light" : "dark"; }
        return theme();
      },
      waitForChart: async function (version) {
        const begun = performance.now();
        while (performance.now() - begun < 5000) {
          if (document.querySelector("#main .sheet svg .line")) { break; }
          await new Promise((resolve) => setTimeout(resolve, 30));
        }
        return version;
      },
    },
  });
  function write(row, tag, cells, texts) {
    cells.forEach((text, number) => {
      const cell = document.createElement(tag);
      cell.textContent = text;
      if (number >= texts) { cell.className = "number"; }
      row.append(cell);
    });
  }
  function fill(place) { fillTable(place, JSON.parse(place.dataset.table)); }
  function fillTable(place, told) {
    const table = document.createElement("table");
    write(table.createTHead().insertRow(), "th", told.head, told.texts);
    const body = table.createTBody();
    told.rows.forEach((row) => write(body.insertRow(), "td", row, told.texts));
    place.replaceChildren(table);
  }
  const zd = (window.zd = window.zd || {});
  zd.fillTable = (place, told) => { if (place) { fillTable(place, told); } };
  function check(label) {
    const box = Object.assign(document.createElement("input"), { type: "checkbox", id: label.dataset.check });
    label.replaceChildren(box, " " + label.dataset.words);
  }
  // Pictures are drawn by the server, as text that holds no script.
  function show(place) { place.innerHTML = place.dataset.picture; }
  // What is chosen is kept here, in the lists themselves: the server says what there is to choose,
  // and no answer of it, however late, can take back what the user chose meanwhile.
  const wished = {};
  const sent = {};
  function tell(store) {
    const told = {};
    document.querySelectorAll("select[data-store=" + store + "]").forEach((list) => {
      told[list.id] = list.value || null;
    });
    const text = JSON.stringify(told);
    if (text === sent[store]) { return; }
    sent[store] = text;
    if (store === "view") {
      zd.wish({ output: told.output, run: told.run, effect: told.ghost });
    } else {
      window.dash_clientside.set_props(store, { data: told });
    }
  }
  function offer(list) {
    const told = JSON.parse(list.dataset.choices);
    const now = list.value;
    const choices = "empty" in list.dataset ? [[list.dataset.empty, ""], ...told.choices] : told.choices;
    list.replaceChildren(...choices.map(([words, value]) => new Option(words, value)));
    const values = choices.map((choice) => choice[1]);
    const kept = [wished[list.id], now, told.first].find((value) => values.includes(value));
    list.value = kept === undefined ? values[0] : kept;
  }
  function choose(told) {
    ["output", "run", "ghost"].filter((name) => name in told).forEach((name) => {
      const list = document.getElementById(name);
      const isThere = Array.from(list.options).some((option) => option.value === told[name]);
      if (!isThere) { list.append(new Option(told[name], told[name])); }
      wished[name] = list.value = told[name];
    });
    if ("from_s" in told) { sent.view = null; zd.go(told); }
    tell("view");
    document.getElementById("measured").scrollIntoView();
  }
  function chooseUnit(serial) {
    const list = document.getElementById("unit");
    wished.unit = list.value = serial;
    tell("chosen");
    list.focus();
    list.scrollIntoView({ block: "start" });
  }
  document.addEventListener("change", (event) => {
    if (!event.target.matches("select[data-store]")) { return; }
    wished[event.target.id] = event.target.value;
    tell(event.target.dataset.store);
  });
  async function press(button) {
    const told = {
      button: button.dataset.press,
      effect: button.dataset.effect || document.getElementById("effect").value,
      step: button.dataset.step || "",
      present: document.getElementById("present").value,
      force: Boolean(document.getElementById("force")?.checked),
    };
    const changes = ["add", "add-chosen", "remove", "undo", "redo", "restore"];
    if (changes.includes(told.button)) {
      // What is shown is out of date from now on; the server's own word follows within a second.
      const bench = document.getElementById("bench");
      bench.classList.add("pressed");
      setTimeout(() => bench.classList.remove("pressed"), 2500);
    }
    await fetch("/press", {
      method: "POST", headers: { "Content-Type": "application/json" }, body: JSON.stringify(told),
    });
  }
  function find(changes, attribute) {
    const places = new Set();
    changes.forEach((change) => {
      if (change.attributeName === attribute) { places.add(change.target); }
      change.addedNodes.forEach((node) => {
        if (node.nodeType !== 1) { return; }
        if (node.hasAttribute(attribute)) { places.add(node); }
        node.querySelectorAll("[" + attribute + "]").forEach((inner) => places.add(inner));
      });
    });
    return Array.from(places);
  }
  new MutationObserver((changes) => {
    find(changes, "data-table").forEach(fill);
    find(changes, "data-picture").forEach(show);
    find(changes, "data-check").forEach(check);
    const lists = find(changes, "data-choices");
    lists.forEach(offer);
    new Set(lists.map((list) => list.dataset.store)).forEach(tell);
  }).observe(root, {
    childList: true, subtree: true, attributes: true, attributeFilter: ["data-table", "data-choices", "data-picture", "data-check"],
  });
  async function send(files) {
    for (const file of files) {
      if (file.size > largest) {
        // Refused by the server from the size alone, so that nothing of it is sent.
        await fetch("/upload/refused?name=" + encodeURIComponent(file.name) + "&size=" + file.size, { method: "POST" });
        continue;
      }
      await fetch("/upload?name=" + encodeURIComponent(file.name), { method: "POST", body: file });
    }
  }
  document.addEventListener("dragover", (event) => {
    event.preventDefault();
    const drop = document.getElementById("drop");
    if (drop) { drop.classList.add("over"); }
  });
  document.addEventListener("dragleave", () => {
    const drop = document.getElementById("drop");
    if (drop) { drop.classList.remove("over"); }
  });
  document.addEventListener("drop", (event) => {
    event.preventDefault();
    const drop = document.getElementById("drop");
    if (drop) { drop.classList.remove("over"); send(event.dataTransfer.files); }
  });
  document.addEventListener("click", (event) => {
    const chooser = event.target.closest("[data-choose]");
    if (chooser) { choose(JSON.parse(chooser.dataset.choose)); }
    const unit = event.target.closest("[data-unit]");
    if (unit) { chooseUnit(unit.dataset.unit); }
    const copied = event.target.closest("[data-copy]");
    if (copied) {
      navigator.clipboard.writeText(document.getElementById(copied.dataset.copy).textContent)
        .then(() => { copied.textContent = "Copied"; });
    }
    const button = event.target.closest("[data-press]");
    if (button) { press(button); }
    if (event.target.id !== "choose") { return; }
    const input = document.createElement("input");
    input.type = "file";
    input.multiple = true;
    input.accept = ".csv,.parquet";
    input.addEventListener("change", () => send(input.files));
    input.click();
  });
})();
