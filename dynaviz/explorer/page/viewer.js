// Rerun's viewer inside the page: a host for the widget of the rerun-notebook wheel.
import widget from './viewer/widget.js'

const PANELS = { top: 'hidden', blueprint: 'hidden', selection: 'hidden', time: 'collapsed' }

export class Viewer {
  /**
   * @param element where to show it
   * @param url of the recording
   * @param on functions: ready(), click(item), time(frame), played(playing)
   */
  constructor(element, url, on) {
    this.on = on
    this.time = null // the frame under the cursor, as the viewer reports it
    this.timeline = null
    this.followed = new Set() // frames to which another viewer has led this one
    this.playing = false
    this.listeners = {}
    this.waiting = []
    this.isReady = false
    const dark = matchMedia('(prefers-color-scheme: dark)').matches
    const values = { _width: 'auto', _height: 'auto', _url: null, _panel_states: PANELS, _theme: dark ? 'dark' : 'light' }
    this.recording = fetch(url).then(answer => answer.arrayBuffer())
    const model = {
      get: name => values[name],
      on: (event, listener) => (this.listeners[event] ??= []).push(listener),
      send: event => this.#hear(event),
    }
    widget.render({ model, el: element })
  }

  /** Move the cursor. */
  seek(frame, play = false) {
    this.time ??= frame
    this.#tell({ type: 'time_ctrl', timeline: 'frame', sequence: String(frame), play })
  }

  /** Move the cursor as another viewer did, and report nothing. */
  follow(frame) {
    if (this.time !== frame) this.followed.add(frame)
    this.seek(frame)
  }

  play(play) { this.seek(this.time ?? 0, play) }

  /** Show the content of an .rrd file: more data of the recording, or a new layout. */
  show(content) { this.#tell({ type: 'rrd' }, [new DataView(content)]) }

  #tell(message, buffers = []) {
    if (!this.isReady) this.waiting.push([message, buffers])
    else this.#send(message, buffers)
  }

  #send(message, buffers) {
    for (const listener of this.listeners['msg:custom'] ?? []) listener(message, buffers)
  }

  #hear(event) {
    if (event === 'ready') {
      // Through the same channel as layouts: they replace that of the recording only if they arrive later.
      this.recording.then(content => this.#send({ type: 'rrd' }, [new DataView(content)]))
      this.recording = null
      return
    }
    const message = JSON.parse(event)
    if (['recording_open', 'timeline_change', 'time_update'].includes(message.type)) this.#open() // whichever comes first
    if (message.type === 'selection_change') this.#click(message.items)
    else if (message.type === 'timeline_change') {
      this.timeline = message.timeline
      this.#move(message.time)
    } else if (message.type === 'time_update') this.#move(message.time)
    else if (message.type === 'play' || message.type === 'pause') {
      this.playing = message.type === 'play'
      this.on.played(this.playing)
    }
  }

  #move(time) {
    if (this.timeline !== null && this.timeline !== 'frame') return
    this.time = Math.round(time)
    if (!this.followed.delete(this.time)) this.on.time(this.time)
  }

  #open() {
    if (this.isReady) return
    this.isReady = true
    // Not in the listener itself: the viewer must not be called while it reports an event.
    setTimeout(() => {
      for (const [message, buffers] of this.waiting.splice(0)) this.#send(message, buffers)
      this.on.ready()
    })
  }

  /** Of things behind each other take the points, which may lie behind a box. */
  #click(items) {
    const hits = items.filter(item => item.type === 'entity' && item.position && !item.entity_path.startsWith('/world/explore'))
    const hit = hits.find(item => item.entity_path === '/world/scan') ?? hits.find(item => item.instance_id !== undefined) ?? hits[0]
    if (hit) setTimeout(() => this.on.click(hit))
  }
}
