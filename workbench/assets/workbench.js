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
  new MutationObserver((changes) => {
    const places = new Set();
    changes.forEach((change) => {
      if (change.type === "attributes") { places.add(change.target); }
      change.addedNodes.forEach((node) => {
        if (node.nodeType !== 1) { return; }
        if (node.dataset.table) { places.add(node); }
        node.querySelectorAll("[data-table]").forEach((inner) => places.add(inner));
      });
    });
    places.forEach(fill);
  }).observe(root, { childList: true, subtree: true, attributes: true, attributeFilter: ["data-table"] });
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
    if (event.target.closest("button.draw, .segments button")) {
      document.getElementById("measured").scrollIntoView();
    }
    if (event.target.id !== "choose") { return; }
    const input = document.createElement("input");
    input.type = "file";
    input.multiple = true;
    input.accept = ".csv,.parquet";
    input.addEventListener("change", () => send(input.files));
    input.click();
  });
})();
