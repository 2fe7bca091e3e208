// A place from above and from the side, before and after; a rectangle in two views is a box.
import { make } from './dom.js'

const COLUMNS = 5 // of a point: x, y, z, frame, flags
const VERDICTS = [null, 'static', 'dynamic', 'undecided']
const SHADES = { static: '#7d808a', removed: '#6d4a63', kept: '#ff7d00', gone: '#ea8fd2', now: '#ffffff', hand: '#56aaf0', box: '#6fb1f0' }

/** The four views of a place. `boxed` is called after a box was drawn or removed. */
export class Places {
  constructor(element, boxed) {
    this.boxed = boxed
    this.side = 0 // the axis that lies horizontally in the views from the side
    this.ranges = [null, null, null] // of the box along x, y and z
    this.views = [
      ['before, from above', 'above', false], ['after, from above', 'above', true],
      ['before, from the side', 'side', false], ['after, from the side', 'side', true],
    ].map(([name, kind, after]) => this.view(element, name, kind, after))
    new ResizeObserver(() => this.draw()).observe(element)
  }

  view(element, name, kind, after) {
    const canvas = make('canvas', { 'aria-label': name }), caption = make('figcaption', {}, name)
    element.append(make('figure', {}, canvas, caption))
    const view = { canvas, kind, after, name, caption }
    let start = null
    canvas.onpointerdown = event => {
      canvas.setPointerCapture(event.pointerId)
      start = this.metres(view, event)
    }
    canvas.onpointermove = event => {
      if (start) this.stretch(view, start, this.metres(view, event))
    }
    canvas.onpointerup = event => {
      const end = this.metres(view, event)
      if (start && Math.hypot(end[0] - start[0], end[1] - start[1]) > 0.1) this.stretch(view, start, end)
      else this.clear()
      start = null
      this.boxed()
    }
    return view
  }

  /** The axes of a view: horizontal and vertical. */
  axes(view) { return view.kind === 'above' ? [0, 1] : [this.side, 2] }

  stretch(view, start, end) {
    this.axes(view).forEach((axis, k) => { this.ranges[axis] = [Math.min(start[k], end[k]), Math.max(start[k], end[k])] })
    this.draw()
  }

  clear() {
    this.ranges = [null, null, null]
    this.draw()
  }

  /** The box, metres: all that is drawn along an axis in which there is no rectangle; null without one. */
  get box() {
    if (!this.place || this.ranges.every(range => !range)) return null
    const [low, high] = this.place.around
    return [this.ranges.map((range, k) => range ? range[0] : low[k]), this.ranges.map((range, k) => range ? range[1] : high[k])]
  }

  /** Points in the box, of the frames from `first` on, and how many of them were removed. */
  inside(first = 0) {
    const box = this.box, found = { points: 0, removed: 0 }
    if (!box) return found
    for (let k = 0; k < this.points.length; k += COLUMNS) {
      const p = this.points
      if (p[k + 3] < first || [0, 1, 2].some(axis => p[k + axis] < box[0][axis] || p[k + axis] > box[1][axis])) continue
      found.points++
      found.removed += this.removed(p[k + 4])
    }
    return found
  }

  show(place, points, answered) {
    Object.assign(this, { place, points, answered, ranges: [null, null, null] })
    this.draw()
  }

  turn() {
    this.side = 1 - this.side
    this.draw()
  }

  /** How metres become pixels in a view. */
  scale(view) {
    const { width, height } = view.canvas, [low, high] = this.place.window
    const [a, b] = this.axes(view), zoom = Math.min(width / (high[a] - low[a]), height / (high[b] - low[b]))
    return { a, b, zoom, left: width / 2 - zoom * (low[a] + high[a]) / 2, bottom: height / 2 + zoom * (low[b] + high[b]) / 2 }
  }

  metres(view, event) {
    const { left, bottom, zoom } = this.scale(view), frame = view.canvas.getBoundingClientRect()
    const ratio = view.canvas.width / frame.width
    return [((event.clientX - frame.left) * ratio - left) / zoom, (bottom - (event.clientY - frame.top) * ratio) / zoom]
  }

  /** Whether a point is removed with the decisions. */
  removed(flags) {
    const verdict = VERDICTS[flags >> 2]
    return verdict === 'static' ? 0 : verdict === 'dynamic' ? 1 : flags & 1
  }

  /** The shade of a point; null if it is not drawn. Before: as the run answered. After: with the decisions, and the proposed one. */
  shade(flags, frame, after) {
    const chosen = flags & 2, decided = flags >> 2
    if (!after) {
      if (chosen) return frame === this.frame ? 'now' : this.answered === 'kept' ? 'kept' : 'gone'
      return flags & 1 ? 'removed' : 'static'
    }
    const removed = chosen && !decided ? 1 - (flags & 1) : this.removed(flags)
    return removed ? null : chosen || decided ? 'hand' : 'static'
  }

  draw() {
    if (!this.place) return
    for (const view of this.views) this.paint(view)
  }

  paint(view) {
    const { canvas } = view, ratio = devicePixelRatio
    canvas.width = canvas.clientWidth * ratio
    canvas.height = canvas.clientHeight * ratio
    if (!canvas.width || !canvas.height) return
    const { a, b, zoom, left, bottom } = this.scale(view), pen = canvas.getContext('2d'), p = this.points
    const groups = { static: [], removed: [], kept: [], gone: [], hand: [], now: [] }
    for (let k = 0; k < p.length; k += COLUMNS) {
      const shade = this.shade(p[k + 4], p[k + 3], view.after)
      if (shade) groups[shade].push(k)
    }
    for (const [shade, rows] of Object.entries(groups)) {
      const size = ratio * (shade === 'static' || shade === 'removed' ? 1.2 : shade === 'now' ? 2.6 : 2)
      pen.fillStyle = SHADES[shade]
      for (const k of rows) pen.fillRect(left + zoom * p[k + a] - size / 2, bottom - zoom * p[k + b] - size / 2, size, size)
    }
    this.measure(view, pen, zoom, ratio)
    const box = this.box
    if (!box) return
    pen.strokeStyle = SHADES.box
    pen.lineWidth = 1.5 * ratio
    pen.strokeRect(left + zoom * box[0][a], bottom - zoom * box[1][b], zoom * (box[1][a] - box[0][a]), zoom * (box[1][b] - box[0][b]))
  }

  /** The length of a metre, or of five. */
  measure(view, pen, zoom, ratio) {
    const length = zoom > 25 * ratio ? 1 : 5, y = view.canvas.height - 10 * ratio
    pen.fillStyle = '#c9ccd3'
    pen.fillRect(10 * ratio, y, length * zoom, ratio)
    pen.font = `${11 * ratio}px system-ui`
    pen.fillText(`${length} m`, 10 * ratio, y - 4 * ratio)
    view.caption.textContent = view.kind === 'side' ? `${view.name}, along ${'yx'[this.side]}` : view.name
  }
}

/** What the scans saw of a place, a column for each frame. */
export function drawTime(canvas, { points, removed, here, through }, frame) {
  const ratio = devicePixelRatio
  canvas.width = canvas.clientWidth * ratio
  canvas.height = canvas.clientHeight * ratio
  const pen = canvas.getContext('2d'), step = canvas.width / points.length, high = canvas.height
  const most = Math.max(1, ...points, ...here)
  for (let k = 0; k < points.length; k++) {
    const column = (value, shade, from, share) => {
      pen.fillStyle = shade
      pen.fillRect(k * step, from * high, Math.max(step - (step > 3 ? 1 : 0), 1), share * high * value)
    }
    column(1, '#262a33', 0, 1)
    column(Math.sqrt(here[k] / most), '#5b5f6b', 0, 0.6)
    column(Math.sqrt(points[k] / most), removed[k] * 2 > points[k] ? SHADES.gone : SHADES.kept, 0, 0.6)
    column(through[k], '#b450ff', 0.68, 0.32)
  }
  pen.fillStyle = SHADES.now
  pen.fillRect((frame + 0.5) * step - ratio, 0, 2 * ratio, high)
}
