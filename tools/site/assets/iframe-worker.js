// Browsers refuse workers to pages that are opened as files. The search's script then runs in a hidden frame instead, which
// gives it what it uses of a worker: `onmessage` and `postMessage`. Messages are copies and come later, as a worker's do.
(function () {
  "use strict";
  if (window.location.protocol !== "file:") return;
  const later = (call) => window.setTimeout(call, 0);
  window.Worker = class extends EventTarget {
    constructor(url) {
      super();
      this.waiting = []; // messages from before the script was there
      this.frame = document.createElement("iframe");
      this.frame.hidden = true;
      document.documentElement.appendChild(this.frame);
      const inside = this.frame.contentWindow;
      inside.postMessage = (data) => later(() => this.deliver(new MessageEvent("message", { data })));
      const script = inside.document.createElement("script");
      script.src = new URL(url, document.baseURI).href;
      script.onload = () => {
        const kept = this.waiting;
        this.waiting = null;
        kept.forEach((data) => this.postMessage(data));
      };
      script.onerror = () => this.deliver(new ErrorEvent("error", { message: "cannot load " + script.src, cancelable: true }));
      inside.document.head.appendChild(script);
    }
    deliver(event) {
      const handler = this["on" + event.type];
      if (handler) handler.call(this, event);
      this.dispatchEvent(event);
    }
    postMessage(data) {
      const copy = window.structuredClone(data);
      const inside = this.frame.contentWindow;
      if (this.waiting) this.waiting.push(copy);
      else later(() => inside && inside.dispatchEvent(new inside.MessageEvent("message", { data: copy })));
    }
    terminate() {
      this.frame.remove();
    }
  };
})();
