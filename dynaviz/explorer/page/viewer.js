// Rerun's viewer inside the page: a host for the widget of the rerun-notebook wheel.
import widget from './viewer/widget.js'

const BACKGROUND = [18, 20, 26] // of 3D views, in every theme
const SHARE = 0.1 // of the canvas that has this colour when a 3D view is drawn
const QUICK = 5 // ms: the viewer reads for 10 ms after each picture, so a shorter one means that it has nothing to read
const IDLE = 3 // such pictures in a row after which it has read everything
const EMPTY = 100 // pictures after which a canvas that stays empty cannot be read, and counts as drawn
const afterFrame = new Set() // called after the viewer has drawn, because its canvas is empty later

console.debug = () => {} // the viewer logs each shader that it compiles there, which takes longer than to compile it

const request = window.requestAnimationFrame.bind(window)
window.requestAnimationFrame = callback => request(time => {
  const begin = performance.now()
  callback(time)
  const took = performance.now() - begin
  for (const look of afterFrame) look(took)
})

const PANELS = { top: 'hidden', blueprint: 'hidden', selection: 'hidden', time: 'collapsed' }

export class Viewer {
  /**
   * @param element where to show it
   * @param contents promises of .rrd files, in the order in which the viewer reads them; the last one is the layout
   * @param frame at which it opens
   * @param on functions: drawn() with the first picture of the recording, click(item), time(frame), played(playing)
   */
  constructor(element, contents, frame, on) {
    this.on = on
    this.start = frame
    this.opened = false // whether the cursor has reached that frame
    this.time = frame // the frame under the cursor, as the viewer reports it
    this.timeline = null
    this.followed = new Set() // frames to which another viewer has led this one
    this.selected = new Set()
    this.playing = false
    this.listeners = {}
    this.waiting = [] // until the recording is read
    this.drawn = false
    this.element = element
    element.classList.add('reading') // it reads after each picture: small ones take less time
    // Always dark, as its 3D views are: labels on them would be white on pale grey otherwise.
    const values = { _width: 'auto', _height: 'auto', _url: null, _panel_states: PANELS, _theme: 'dark' }
    this.contents = Promise.all(contents)
    const model = {
      get: name => values[name],
      on: (event, listener) => (this.listeners[event] ??= []).push(listener),
      send: event => this.#hear(event),
    }
    widget.render({ model, el: element })
  }

  /** Move the cursor. A viewer that has not opened yet opens there. */
  seek(frame, play = false) {
    if (this.opened) this.#tell({ type: 'time_ctrl', timeline: 'frame', sequence: String(frame), play })
    else this.start = this.time = frame
  }

  /** Move the cursor as another viewer did, and report nothing. */
  follow(frame) {
    if (this.time !== frame) this.followed.add(this.led = frame)
    this.seek(frame)
  }

  play(play) { this.seek(this.time, play) }

  /** Show the content of an .rrd file: more data of the recording, or a new layout. */
  show(content) {
    if (this.waiting) this.waiting.push(content)
    else this.#send(content)
  }

  #send(content) { this.#tell({ type: 'rrd' }, [new DataView(content)]) }

  #tell(message, buffers = []) {
    for (const listener of this.listeners['msg:custom'] ?? []) listener(message, buffers)
  }

  #hear(event) {
    if (event === 'ready') {
      this.contents.then(contents => {
        this.waiting.unshift(contents.pop())
        for (const content of contents) this.#send(content)
        this.contents = null
      })
      return
    }
    const message = JSON.parse(event)
    if (message.type === 'selection_change') this.#click(message.items)
    else if (message.type === 'timeline_change') {
      this.timeline = message.timeline
      this.#move(message.time)
    } else if (message.type === 'time_update') this.#move(message.time)
    else if (message.type === 'play' || message.type === 'pause') {
      this.playing = message.type === 'play'
      if (this.opened) this.on.played(this.playing)
    }
  }

  /** The viewer's cursor has moved. */
  #move(time) {
    const frame = Math.round(time)
    if (!this.opened) {
      this.#open(frame)
      return
    }
    if (this.timeline !== 'frame') return
    this.time = frame
    if (!this.followed.delete(frame)) this.on.time(frame)
    else if (frame === this.led) this.followed.clear() // frames in between may have been skipped
  }

  /** While the recording loads, the cursor starts on any timeline; there is none to set before the first report. */
  #open(frame) {
    if (this.timeline === 'frame' && frame === this.start) {
      this.opened = true
      this.#awaitRead()
    } else {
      // Not in the listener itself: the viewer must not be called while it reports an event.
      setTimeout(() => this.#tell({ type: 'time_ctrl', timeline: 'frame', sequence: String(this.start), play: false }))
    }
  }

  /** When everything is read, show the layout, in full size. */
  #awaitRead() {
    let idle = 0
    const look = took => {
      idle = took < QUICK ? idle + 1 : 0
      if (idle < IDLE) return
      afterFrame.delete(look)
      this.element.classList.remove('reading')
      const { waiting } = this
      this.waiting = null
      setTimeout(() => {
        for (const content of waiting) this.#send(content)
        this.#awaitPicture()
      })
    }
    afterFrame.add(look)
  }

  #awaitPicture() {
    const canvas = this.element.querySelector('canvas'), small = Object.assign(document.createElement('canvas'), { width: 48, height: 48 })
    const context = small.getContext('2d', { willReadFrequently: true })
    const done = () => {
      if (this.drawn) return
      this.drawn = true
      afterFrame.delete(look)
      setTimeout(() => this.on.drawn())
    }
    let empty = 0
    const look = () => {
      context.drawImage(canvas, 0, 0, small.width, small.height)
      const pixels = context.getImageData(0, 0, small.width, small.height).data
      let same = 0
      if (!pixels.some(Boolean) && ++empty >= EMPTY) done()
      for (let k = 0; k < pixels.length; k += 4) same += BACKGROUND.every((value, part) => Math.abs(pixels[k + part] - value) < 4)
      if (same > SHARE * small.width * small.height) done()
    }
    afterFrame.add(look)
  }

  /**
   * Of things behind each other take the points, which may lie behind a box; a ray drawn in front stands for the place.
   * With Ctrl the viewer adds to what is selected, or removes from it: what it adds counts.
   */
  #click(items) {
    const name = item => `${item.entity_path} ${item.instance_id}`, before = this.selected
    this.selected = new Set(items.map(name))
    const hits = items.filter(item => item.type === 'entity' && item.position && !before.has(name(item)))
    const points = hits.filter(item => !item.entity_path.startsWith('/world/explore'))
    const hit = points.find(item => item.entity_path === '/world/scan') ?? points.find(item => item.instance_id !== undefined) ?? points[0] ?? hits[0]
    if (hit) setTimeout(() => this.on.click(hit))
  }
}
