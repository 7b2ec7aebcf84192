"use strict";
// Says so when the server is gone, and finds it again when it is restarted on the same port.
(function () {
  const zd = (window.zd = window.zd || {});
  let gone = false;
  function tell() {
    let box = document.getElementById("gone");
    if (!gone) { box?.remove(); return; }
    if (box) { return; }
    box = document.createElement("div");
    box.id = "gone";
    box.className = "message error";
    box.setAttribute("role", "alert");
    const words = document.createElement("p");
    words.textContent = "The workbench is not running any more: what is shown was found before, and nothing can be done. " +
      "Start it again with `zerodrift workbench` in this project's folder; this page finds it by itself.";
    box.append(words);
    document.body.prepend(box);
  }
  async function look() {
    try {
      const answer = await fetch("/alive", { cache: "no-store" });
      if (gone && answer.ok) { location.reload(); return; }
      if (answer.status === 403) { setGone(true); return; }
      setGone(false);
    } catch (error) { setGone(true); }
  }
  function setGone(now) {
    if (now === gone) { return; }
    gone = now;
    document.documentElement.classList.toggle("gone", gone);
    tell();
  }
  zd.lost = look;
  setInterval(look, 1500);
})();
