"use strict";
(function () {
  const plots = Array.from(document.querySelectorAll("figure .plot"));
  if (!plots.length) { return; }
  const here = document.currentScript.src;
  const script = document.createElement("script");
  script.src = new URL("plotly.min.js", here).href;
  script.addEventListener("load", () => {
    plots.forEach((div) => {
      const figure = JSON.parse(div.parentElement.querySelector("script").textContent);
      Plotly.newPlot(div, figure.data, figure.layout, {
        displaylogo: false, responsive: true, showSendToCloud: false, displayModeBar: false,
      });
    });
  });
  document.head.append(script);
})();
