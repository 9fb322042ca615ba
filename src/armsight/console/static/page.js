// What every page needs beside NiceGUI: the page's language, a connection that is gone, and files brought into the cell's folder.
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
