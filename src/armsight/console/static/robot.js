// The robot's controls: the enable that is held, jog keys that are held, the stop. Whatever ends the holding lets go.
(() => {
  const BEAT_MS = 30; // an enable is none after 150 ms: a few may be late
  let socket = null, held = false, push = null, source = null, state = {}, heard = 0, instance = null, tried = 0;

  const bar = () => document.querySelector("[data-robot]");
  const say = (message) => socket && socket.readyState === WebSocket.OPEN && socket.send(JSON.stringify(message));
  const beat = () => {
    number += 1; // by both ways; the first to arrive counts
    sayLine({ type: "heartbeat", enable: held, number, key: state.key });
    say({ do: "beat", enable: held, push: held ? push : null, seen: state.t, number });
  };

  // The line for stops: a port of its own, which no picture and no page keeps waiting. Without it the page's way does.
  let line = null, session = null, seq = 0, number = 0, wanted = null;
  const sayLine = (message) =>
    session && line.readyState === WebSocket.OPEN && line.send(JSON.stringify({ ...message, session, seq: ++seq }));
  function openLine() {
    if (line || !state.line) return;
    wanted = wanted ?? performance.now();
    const scheme = location.protocol === "https:" ? "wss:" : "ws:";
    const opened = (line = new WebSocket(`${scheme}//${location.hostname}:${state.line}/api/v1/stop`));
    opened.onmessage = (event) => {
      const told = JSON.parse(event.data);
      if (told.type !== "line") return;
      [session, seq, wanted] = [told.session, 0, null];
    };
    opened.onclose = () => {
      session = null;
      wanted = wanted ?? performance.now();
      setTimeout(() => {
        line = null;
        openLine();
      }, 1000);
    };
  }

  function connect() {
    const here = bar();
    if (!here) return void setTimeout(connect, 100);
    const scheme = location.protocol === "https:" ? "wss:" : "ws:";
    socket = new WebSocket(`${scheme}//${location.host}/console/robot`);
    socket.onopen = () => say({ do: "page", page: here.dataset.robot });
    socket.onmessage = (event) => {
      state = JSON.parse(event.data);
      heard = performance.now();
      tried = 0;
      instance = instance || here.dataset.instance;
      openLine();
      show();
    };
    socket.onclose = () => {
      letGo();
      state = {};
      show();
      tried += 1;
      setTimeout(connect, Math.min(3000, 300 * tried));
    };
  }

  function hold(element, what) {
    held = true;
    push = what;
    source = element;
    element.setAttribute("aria-pressed", "true");
    beat();
    show();
  }
  function letGo() {
    if (source) source.setAttribute("aria-pressed", "false");
    const was = held;
    held = false;
    push = null;
    source = null;
    if (was) beat();
    show();
  }
  function stop() {
    letGo();
    sayLine({ type: "stop" });
    say({ do: "stop" });
    fetch("/console/stop", { method: "POST", keepalive: true }).catch(() => {});
  }

  function show() {
    const here = bar();
    if (!here) return;
    const gone = !socket || socket.readyState !== WebSocket.OPEN || performance.now() - heard > 1500;
    const stale = Boolean(instance && state.instance && state.instance !== instance);
    const lamp = document.querySelector("[data-testid=robot-state]");
    const words = stale ? here.dataset.stale : gone ? here.dataset.gone : state.words;
    const level = stale || gone ? "bad" : state.level;
    if (lamp && words !== undefined) {
      if (lamp.textContent !== words) lamp.textContent = words;
      lamp.dataset.level = level;
    }
    const refused = document.getElementById("robot-refused");
    const shared = state.mine && wanted !== null && performance.now() - wanted > 3000 ? here.dataset.shared : "";
    if (refused) refused.textContent = gone || stale ? "" : state.refused || shared;
    const enable = document.querySelector("[data-testid=enable]");
    if (enable) {
      enable.dataset.alive = state.enabled ? "true" : "false";
      enable.toggleAttribute("disabled", gone || stale || state.drives === false);
    }
    const reset = document.querySelector("[data-testid=reset]");
    if (reset) reset.hidden = !state.stopped || state.drives === false;
    const override = document.querySelector("[data-testid=override]");
    if (override && state.override !== undefined && document.activeElement !== override) override.value = Math.round(100 * state.override);
    const told = document.getElementById("override-told");
    if (told && override) told.textContent = `${override.value} %`;
    if ((gone || stale) && held) letGo();
  }

  const holder = (target) => target instanceof Element && target.closest("[data-testid=enable], [data-jog]");
  const what = (element) => {
    if (!element.dataset.jog) return null;
    const [frame, axis, sense] = element.dataset.jog.split(":");
    return { frame, axis: Number(axis), sense };
  };
  document.addEventListener("pointerdown", (event) => {
    const element = holder(event.target);
    if (!element || event.button !== 0 || element.hasAttribute("disabled")) return;
    event.preventDefault();
    element.focus();
    element.setPointerCapture(event.pointerId);
    hold(element, what(element));
  });
  for (const kind of ["pointerup", "pointercancel", "lostpointercapture"])
    document.addEventListener(kind, (event) => held && holder(event.target) === source && letGo(), true);
  document.addEventListener("keydown", (event) => {
    if (event.key === "Escape" && bar()) return void stop();
    const element = holder(event.target);
    if (!element || (event.key !== " " && event.key !== "Enter")) return;
    event.preventDefault();
    if (!event.repeat && !element.hasAttribute("disabled")) hold(element, what(element));
  });
  document.addEventListener("keyup", (event) => held && (event.key === " " || event.key === "Enter") && letGo());
  document.addEventListener("focusout", (event) => held && event.target === source && letGo());
  document.addEventListener("contextmenu", (event) => holder(event.target) && event.preventDefault());
  document.addEventListener("click", (event) => {
    if (!(event.target instanceof Element)) return;
    if (event.target.closest("[data-testid=stop]")) stop();
    if (event.target.closest("[data-testid=reset]")) say({ do: "reset" });
  });
  document.addEventListener("input", (event) => {
    if (!(event.target instanceof HTMLInputElement) || event.target.dataset.testid !== "override") return;
    say({ do: "override", share: Number(event.target.value) / 100 });
    show();
  });
  window.addEventListener("blur", letGo);
  window.addEventListener("pagehide", letGo);
  document.addEventListener("visibilitychange", () => document.hidden && letGo());
  setInterval(() => {
    if (held) beat();
    show();
  }, BEAT_MS);
  connect();
})();
