// The search of a page runs in a worker, which browsers refuse to a page that is opened from its directory. There a
// frame that is not shown takes its place: it loads the same script, and messages go to and fro as they do with a
// worker. The theme fetches such a shim from elsewhere, unless there is one of this name.
class IFrameWorker extends EventTarget {
  constructor(url) {
    super()
    this.frame = document.createElement("iframe")
    this.frame.hidden = true
    document.body.appendChild(this.frame)
    const inner = this.frame.contentDocument
    inner.open()
    inner.write(`<html><body><script>
      postMessage = message => parent.postMessage(message, "*")
      importScripts = (...urls) => urls.reduce((before, url) => before.then(() => new Promise((done, fail) => {
        const script = document.createElement("script")
        Object.assign(script, { src: url, onload: done, onerror: fail })
        document.body.appendChild(script)
      })), Promise.resolve())
    </script><script src="${url}"></script></body></html>`)
    inner.close()
    this.ready = new Promise(done => this.frame.addEventListener("load", done, { once: true }))
    window.addEventListener("message", event => {
      if (event.source === this.frame.contentWindow) {
        const copy = new MessageEvent("message", { data: event.data })
        this.dispatchEvent(copy)
        if (this.onmessage) this.onmessage(copy)
      }
    })
  }

  postMessage(message) {
    this.ready.then(() => this.frame.contentWindow.dispatchEvent(new MessageEvent("message", { data: message })))
  }

  terminate() {
    this.frame.remove()
  }
}

if (location.protocol === "file:") Object.assign(window, { IFrameWorker, Worker: IFrameWorker })
