// The points of a case from above and from the side: a rectangle chooses those whose evidence is shown.
import { make, whole } from './dom.js'
import { served } from './server.js'

const SHADES = { static_kept: 'static', unlabelled_kept: 'static', dynamic_removed: 'ghost removed', false_negative: 'ghost kept', false_positive: 'hole removed', unlabelled_removed: 'cluster' }
const W = 340, GAP = 6
const MOST = { beside: 150, below: 210 } // high
const STEP = 0.05 // of a view, by which a key moves an edge
const KEYS = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] }
const HINT = served ? 'Drag a rectangle for the evidence of the points inside; arrow keys move it, with Shift they size it, Escape removes it.' : 'Click a large point to see why it got its label.'
const REACH = 14 // from a click to a point

/**
 * @param map as the server's surroundings; choose: called with the rows of the points with evidence that a rectangle
 *   contains, joined by commas, or with null for all; pick: called with the row of a clicked point with evidence, without a server
 */
export function caseMap({ size, outcome, points, around, evidence }, choose, pick) {
  const [along, across] = size[0] >= size[1] ? [0, 1] : [1, 0] // the longer side lies horizontally
  const beside = Math.min((W - GAP) / 2 / size[along], MOST.beside / Math.max(size[across], size[2]))
  const below = Math.min(W / size[along], (MOST.below - GAP) / (size[across] + size[2]))
  const scale = Math.max(beside, below), wide = scale * size[along], rows = []
  const views = [['from above', across], ['from the side', 2]].map(([name, axis], k) => ({
    name, axis, wide, high: scale * size[axis],
    x: k && beside >= below ? wide + GAP : 0, y: k && beside < below ? scale * size[across] + GAP : 0,
  }))
  const place = ({ x, y, high, axis }, at) => [x + scale * at[along], y + high - scale * at[axis]]
  const dots = (view, list, kind) => make('path', { class: kind, d: list.map(at => `M${place(view, at).map(value => value.toFixed(1)).join(' ')}h0`).join('') })
  const box = make('rect', { class: 'chosen', visibility: 'hidden' }), caption = make('figcaption', { 'aria-live': 'polite' }, HINT)
  let drawn = null // the rectangle: its view and two corners, as shares of the view

  /** Show the rectangle; done: look which points it contains. */
  function put(rectangle, done = true) {
    drawn = rectangle
    box.setAttribute('visibility', drawn ? 'visible' : 'hidden')
    if (!drawn) {
      caption.textContent = HINT
      choose(null)
      return
    }
    const { view: { x, y, wide, high }, ends } = drawn, [left, right] = sorted(ends, 0), [top, bottom] = sorted(ends, 1)
    const edges = { x: x + wide * left, y: y + high * top, width: wide * (right - left), height: high * (bottom - top) }
    for (const [name, value] of Object.entries(edges)) box.setAttribute(name, value)
    if (!done) return
    const inside = at => {
      const [u, v] = place(drawn.view, at)
      return u >= edges.x && u <= edges.x + edges.width && v >= edges.y && v <= edges.y + edges.height
    }
    const count = points.filter(inside).length, chosen = evidence.filter(([, ...at]) => inside(at)).map(([row]) => row)
    caption.textContent = `${whole(count)} of ${whole(points.length)} points${chosen.length ? `: above, the evidence of ${whole(chosen.length)} of them that have it stored.` : ', none with stored evidence: click one in the viewer.'}`
    choose(chosen.length ? chosen.join() : null)
  }

  const share = (event, { x, y, wide, high }) => {
    const { left, top, width } = svg.getBoundingClientRect(), zoom = W / width
    return [clamp(((event.clientX - left) * zoom - x) / wide), clamp(((event.clientY - top) * zoom - y) / high)]
  }
  for (const view of views) {
    const pane = make('g', { class: 'pane', tabindex: 0, role: 'application', 'aria-label': `the case ${view.name}; ${HINT}`,
      click: !served && (event => {
        const [u, v] = share(event, view), at = [view.x + u * view.wide, view.y + v * view.high]
        const far = ([, ...of]) => Math.hypot(...place(view, of).map((value, k) => value - at[k]))
        const near = evidence.reduce((best, each) => far(each) < far(best) ? each : best, evidence[0])
        if (near && far(near) < REACH) pick(near[0])
      }),
      pointerdown: served && (event => {
        pane.setPointerCapture(event.pointerId)
        const start = share(event, view)
        pane.onpointermove = event => put({ view, ends: [start, share(event, view)] }, false)
        pane.onpointerup = event => {
          pane.onpointermove = pane.onpointerup = null
          const ends = [start, share(event, view)]
          put(Math.hypot((ends[1][0] - ends[0][0]) * view.wide, (ends[1][1] - ends[0][1]) * view.high) > 3 ? { view, ends } : null)
        }
      }),
      keydown: served && (event => {
        if (event.key === 'Escape') put(null)
        else if (KEYS[event.key]) {
          const [first, last] = drawn?.view === view ? drawn.ends : [[0.3, 0.3], [0.7, 0.7]]
          const move = ends => ends.map((value, k) => clamp(value + STEP * KEYS[event.key][k]))
          put({ view, ends: [event.shiftKey ? first : move(first), move(last)] })
        } else return
        event.preventDefault()
      }) },
    make('rect', { class: 'ground', x: view.x, y: view.y, width: view.wide, height: view.high }),
    ...Object.entries(around).filter(([name]) => name !== outcome).map(([name, list]) => dots(view, list, SHADES[name])),
    dots(view, points, SHADES[outcome]),
    dots(view, evidence.map(([, ...at]) => at), `${SHADES[outcome]} evidence`),
    make('text', { x: view.x + 4, y: view.y + 11 }, view.name))
    rows.push(pane)
  }
  const last = views[1], svg = make('svg', { class: 'map', viewBox: `0 0 ${W} ${Math.max(views[0].high, last.y + last.high)}` }, rows, box)
  return make('figure', {}, svg, caption)
}

const clamp = value => Math.min(Math.max(value, 0), 1)
const sorted = (ends, axis) => [ends[0][axis], ends[1][axis]].sort((a, b) => a - b)
