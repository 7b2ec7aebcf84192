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
          if (document.querySelector("#main .scatterlayer .trace")) { break; }
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
  function fill(place) {
    const told = JSON.parse(place.dataset.table);
    const table = document.createElement("table");
    write(table.createTHead().insertRow(), "th", told.head, told.texts);
    const body = table.createTBody();
    told.rows.forEach((row) => write(body.insertRow(), "td", row, told.texts));
    place.replaceChildren(table);
  }
  // What is chosen is kept here, in the lists themselves: the server says what there is to choose,
  // and no answer of it, however late, can take back what the user chose meanwhile.
  const wished = {};
  const sent = {};
  let part = null;
  function tell(store) {
    const told = {};
    document.querySelectorAll("select[data-store=" + store + "]").forEach((list) => {
      told[list.id] = list.value || null;
    });
    if (store === "view") { told.part = part; }
    const text = JSON.stringify(told);
    if (text !== sent[store]) {
      sent[store] = text;
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
    if ("from_s" in told) { part = Object.assign({}, told, { number: (part ? part.number : 0) + 1 }); }
    ["output", "run", "ghost"].filter((name) => name in told).forEach((name) => {
      const list = document.getElementById(name);
      const isThere = Array.from(list.options).some((option) => option.value === told[name]);
      if (!isThere) { list.append(new Option(told[name], told[name])); }
      wished[name] = list.value = told[name];
    });
    tell("view");
    document.getElementById("measured").scrollIntoView();
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
      present: document.getElementById("present").value,
      force: Boolean(document.querySelector("#force input")?.checked),
    };
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
    const lists = find(changes, "data-choices");
    lists.forEach(offer);
    new Set(lists.map((list) => list.dataset.store)).forEach(tell);
  }).observe(root, {
    childList: true, subtree: true, attributes: true, attributeFilter: ["data-table", "data-choices"],
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
