// Camera pictures with what was found drawn on them. One message holds one picture and its findings, so that they
// always belong together; the next one is asked for when this one is on the screen, so that nothing piles up.
(() => {
  const COLOURS = {
    named: "#009E73", left: "#56B4E9", right: "#CC79A7", other: "#E69F00", line: "#56B4E9", residual: "#D55E00",
    mask: "rgba(0,0,0,0.55)",
  };
  const RESIDUAL_SCALE = 100;

  class Picture {
    constructor(canvas) {
      this.canvas = canvas;
      this.context = canvas.getContext("2d", { alpha: false });
      this.side = canvas.dataset.side;
      this.shown = 0;
      [this.width, this.height] = [canvas.width, canvas.height];
      this.masks = [];
      this.drag = null;
      this.connect();
      canvas.addEventListener("pointerdown", (e) => this.begin(e));
      canvas.addEventListener("pointermove", (e) => this.extend(e));
      canvas.addEventListener("pointerup", (e) => this.end(e));
    }

    connect() {
      const scheme = location.protocol === "https:" ? "wss" : "ws";
      this.socket = new WebSocket(`${scheme}://${location.host}/console/pictures/${this.side}`);
      this.socket.binaryType = "arraybuffer";
      this.socket.onopen = () => this.ask();
      this.socket.onmessage = (message) => this.take(message.data);
      this.socket.onclose = () => {
        if (document.body.contains(this.canvas)) setTimeout(() => this.connect(), 1000);
      };
    }

    ask() { // no wider than it stands on this screen: decoding and drawing more is what slows a page down
      this.socket.send(String(Math.ceil(Math.max(320, this.canvas.clientWidth * devicePixelRatio))));
    }

    async take(data) {
      this.waiting = data;
      if (this.drawing) return;
      this.drawing = true;
      while (this.waiting) {
        const next = this.waiting;
        this.waiting = null;
        if (this.socket.readyState === WebSocket.OPEN) this.ask();
        await this.show(next).catch(() => {}); // a picture cut short by the network: the next one comes
      }
      this.drawing = false;
    }

    async show(data) {
      const length = new DataView(data).getUint32(0, true);
      const found = JSON.parse(new TextDecoder().decode(new Uint8Array(data, 4, length)));
      this.canvas.toggleAttribute("data-lost", Boolean(found.lost));
      if (data.byteLength === 4 + length) return; // a camera that has not given any picture yet
      const blob = new Blob([new Uint8Array(data, 4 + length)], { type: "image/jpeg" });
      const bitmap = await createImageBitmap(blob);
      if (this.canvas.width !== bitmap.width || this.canvas.height !== bitmap.height) {
        this.canvas.width = bitmap.width;
        this.canvas.height = bitmap.height;
      }
      if (this.width !== found.width || this.height !== found.height) {
        [this.width, this.height] = [found.width, found.height];
        this.canvas.style.aspectRatio = `${this.width} / ${this.height}`;
      }
      const c = this.context;
      c.setTransform(1, 0, 0, 1, 0, 0);
      c.drawImage(bitmap, 0, 0);
      c.setTransform(bitmap.width / this.width, 0, 0, bitmap.height / this.height, 0, 0); // from here on in its px
      bitmap.close();
      this.masks = found.masks;
      this.draw(found);
      this.shown += 1;
      this.canvas.dataset.shown = this.shown;
    }

    draw(found) {
      const c = this.context;
      const size = Math.max(1, this.width / Math.min(640, this.canvas.clientWidth || 640)); // as large on small pictures
      c.lineWidth = 1.5 * size;
      c.font = `600 ${16 * size}px system-ui, sans-serif`;
      c.fillStyle = COLOURS.mask;
      const drawn = this.drag ? [...this.masks, this.drag] : this.masks;
      for (const [u0, v0, u1, v1] of drawn) c.fillRect(Math.min(u0, u1), Math.min(v0, v1), Math.abs(u1 - u0), Math.abs(v1 - v0));
      c.strokeStyle = COLOURS.line;
      c.globalAlpha = 0.6;
      found.epipolar.forEach((curve, n) => {
        c.strokeStyle = COLOURS[(found.epipolar_views || [])[n]] || COLOURS.line;
        c.beginPath();
        curve.forEach(([u, v], i) => (i ? c.lineTo(u, v) : c.moveTo(u, v)));
        c.stroke();
      });
      c.globalAlpha = 1;
      for (const spot of this.canvas.dataset.plain ? found.spots.filter((s) => s.name) : found.spots) {
        const colour = spot.name ? COLOURS[spot.view] || COLOURS.named : COLOURS.other;
        c.strokeStyle = colour;
        this.mark(spot, size);
        const mark = spot.view ? this.canvas.dataset[spot.view === "left" ? "markLeft" : "markRight"] : "";
        this.label(spot.name ? `${spot.name} ${mark}`.trim() : "?", spot.u_px + 14 * size, spot.v_px - 8 * size, colour, size);
        if (spot.residual_px) {
          c.strokeStyle = COLOURS.residual;
          c.beginPath();
          c.moveTo(spot.u_px, spot.v_px);
          c.lineTo(spot.u_px + RESIDUAL_SCALE * spot.residual_px[0], spot.v_px + RESIDUAL_SCALE * spot.residual_px[1]);
          c.stroke();
        }
      }
    }

    mark(spot, size) {
      const c = this.context;
      const [u, v, r] = [spot.u_px, spot.v_px, 11 * size];
      c.beginPath();
      if (!spot.name) c.rect(u - 9 * size, v - 9 * size, 18 * size, 18 * size);
      else if (spot.view !== "right") c.arc(u, v, r, 0, 7);
      else {
        [[0, -1.3], [1.3, 0], [0, 1.3], [-1.3, 0]].forEach(([x, y], i) => (i ? c.lineTo(u + r * x, v + r * y) : c.moveTo(u + r * x, v + r * y)));
        c.closePath();
      }
      c.stroke();
    }

    label(text, u, v, colour, size) {
      const c = this.context;
      c.lineWidth = 4 * size;
      c.strokeStyle = "#000";
      c.strokeText(text, u, v);
      c.fillStyle = colour;
      c.fillText(text, u, v);
      c.lineWidth = 1.5 * size;
    }

    place(event) {
      const box = this.canvas.getBoundingClientRect();
      return [
        ((event.clientX - box.left) * this.width) / box.width,
        ((event.clientY - box.top) * this.height) / box.height,
      ];
    }

    begin(event) {
      if (this.canvas.dataset.masking !== "true") return;
      const [u, v] = this.place(event);
      this.drag = [u, v, u, v];
      this.canvas.setPointerCapture(event.pointerId);
    }

    extend(event) {
      if (!this.drag) return;
      [this.drag[2], this.drag[3]] = this.place(event);
    }

    end() {
      if (!this.drag) return;
      const mask = this.drag;
      this.drag = null;
      if (Math.abs(mask[2] - mask[0]) > 3 && Math.abs(mask[3] - mask[1]) > 3)
        emitEvent("armsight_mask", { side: this.side, mask });
    }
  }

  const known = new WeakSet();
  const look = () => {
    for (const canvas of document.querySelectorAll("canvas[data-side]")) {
      if (known.has(canvas)) continue;
      known.add(canvas);
      new Picture(canvas);
    }
  };
  new MutationObserver(look).observe(document.documentElement, { childList: true, subtree: true });
  document.addEventListener("DOMContentLoaded", look);
})();
