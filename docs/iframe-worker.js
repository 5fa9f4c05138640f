// A page that is opened from a folder may start no worker, and the search of the site is one: there it runs in a frame.
if (location.protocol === "file:")
  window.Worker = class extends EventTarget {
    constructor(url) {
      super()
      const frame = document.createElement("iframe")
      frame.hidden = true
      document.body.append(frame)
      this.inner = frame.contentWindow
      window.addEventListener("message", ({ source, data }) => {
        if (source === this.inner) this.dispatchEvent(new MessageEvent("message", { data }))
      })
      this.ready = new Promise(loaded => {
        const inside = this.inner.document
        this.inner.postMessage = data => window.dispatchEvent(new MessageEvent("message", { data, source: this.inner }))
        const script = inside.createElement("script")
        script.src = url
        script.onload = loaded
        inside.body.append(script)
      })
    }
    postMessage(data) {
      this.ready.then(() => this.inner.dispatchEvent(new MessageEvent("message", { data })))
    }
  }
