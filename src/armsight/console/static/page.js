// What every page needs beside NiceGUI: the page's language, and files brought into the cell's folder.
(() => {
  document.addEventListener("DOMContentLoaded", () => (document.documentElement.lang = "en"));
  document.addEventListener("change", async (event) => {
    const chooser = event.target;
    if (!(chooser instanceof HTMLInputElement) || !chooser.dataset.upload || !chooser.files.length) return;
    const file = chooser.files[0];
    const said = document.getElementById("uploaded");
    try {
      const answer = await fetch(chooser.dataset.upload + encodeURIComponent(file.name), { method: "PUT", body: file });
      said.textContent = await answer.text();
      said.dataset.level = answer.ok ? "good" : "bad";
    } catch (error) {
      said.textContent = String(error);
      said.dataset.level = "bad";
    }
    chooser.value = "";
  });
})();
