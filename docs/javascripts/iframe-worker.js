// Browsers start no worker from a file. For pages opened from disk, this runs the search in a hidden frame instead,
// which speaks to the page as a worker would.
if (location.protocol === "file:") {
  window.Worker = class extends EventTarget {
    constructor(url) {
      super()
      this.onmessage = null
      this.frame = document.createElement("iframe")
      this.frame.hidden = true
      document.body.appendChild(this.frame)
      const prelude = `
        var self = window
        window.postMessage = (data) => parent.dispatchEvent(new MessageEvent("frame-worker", { data }))
        window.importScripts = (...urls) => urls.reduce((before, url) => before.then(() => new Promise((done, fail) => {
          const script = document.createElement("script")
          script.src = url
          script.onload = done
          script.onerror = () => fail(new Error("cannot load " + url))
          document.body.appendChild(script)
        })), Promise.resolve())`
      const page = this.frame.contentDocument
      page.open()
      page.write("<!doctype html><html><body></body></html>")
      page.close()
      this.ready = new Promise((done) => {
        const first = page.createElement("script")
        first.textContent = prelude
        page.body.appendChild(first)
        const worker = page.createElement("script")
        worker.src = url
        worker.onload = done
        page.body.appendChild(worker)
      })
      window.addEventListener("frame-worker", (event) => {
        const message = new MessageEvent("message", { data: event.data })
        this.dispatchEvent(message)
        if (this.onmessage) this.onmessage(message)
      })
    }
    postMessage(data) {
      this.ready.then(() => this.frame.contentWindow.dispatchEvent(new MessageEvent("message", { data })))
    }
    terminate() {
      this.frame.remove()
    }
  }
}
