// What every page needs beside NiceGUI: its language, a connection that is gone, scenes that are slow, and files brought into the cell.
(() => {
  // Without its connection the page keeps what it showed last: nothing of it may look like now.
  setInterval(() => {
    if (window.socket) document.documentElement.toggleAttribute("data-offline", !window.socket.connected);
  }, 250);
  // Where the log-in has ended, the page that asks for a token comes.
  setInterval(async () => {
    if (!window.socket || window.socket.connected) return;
    const answer = await fetch(location.href, { method: "HEAD" }).catch(() => null);
    if (answer && answer.status === 401) location.reload();
  }, 3000);
  // A computer without a graphics processor works on a scene for a tenth of a second, and tells no enable meanwhile: from
  // eight such stretches in two seconds on, each pair of seconds halves the scene's pixels across. Loading makes some too.
  let ratio = 1;
  const long = [];
  const coarser = (list) => {
    long.push(...list.getEntries().map((task) => task.startTime).filter((t) => t > 4000));
    while (long[0] < performance.now() - 2000) long.shift();
    const scene = document.querySelector(".nicegui-scene");
    if (long.length < 8 || !scene || ratio <= 0.25) return;
    long.length = 0;
    ratio /= 2;
    getElement(Number(scene.id.slice(1))).renderer?.setPixelRatio(ratio * window.devicePixelRatio);
  };
  if (window.PerformanceObserver?.supportedEntryTypes.includes("longtask"))
    new PerformanceObserver(coarser).observe({ type: "longtask" });
  document.addEventListener("DOMContentLoaded", () => (document.documentElement.lang = "en"));
  document.addEventListener("change", async (event) => {
    const chooser = event.target;
    if (!(chooser instanceof HTMLInputElement) || !chooser.dataset.upload || !chooser.files.length) return;
    const file = chooser.files[0];
    const said = document.getElementById("uploaded");
    if (file.size > Number(chooser.dataset.largest)) {
      said.textContent = chooser.dataset.tooBig; // a gigabyte is not sent only to be refused
      said.dataset.level = "bad";
      chooser.value = "";
      return;
    }
    try {
      const answer = await fetch(chooser.dataset.upload + encodeURIComponent(file.name), { method: "PUT", body: file });
      said.textContent = await answer.text();
      said.dataset.level = answer.ok ? "good" : "bad";
    } catch {
      said.textContent = chooser.dataset.notSent;
      said.dataset.level = "bad";
    }
    chooser.value = "";
  });
})();
