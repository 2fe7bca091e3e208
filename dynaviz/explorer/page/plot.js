// Small plots, as inline SVG.
import { make, whole } from './dom.js'

/** Wrong points over the frames of the run. */
export function sparkline(counts, worst, width = 150, height = 18) {
  const most = Math.max(...counts, 1), step = width / counts.length
  const bars = counts.map((count, k) => count && make('rect', {
    x: k * step, width: Math.max(step - 0.5, 0.5), y: height * (1 - Math.max(count / most, 0.08)), height: height * Math.max(count / most, 0.08),
    class: k === worst ? 'worst' : null,
  }))
  return make('svg', { class: 'spark', viewBox: `0 0 ${width} ${height}`, preserveAspectRatio: 'none', role: 'img', 'aria-label': 'wrong points over the frames' }, bars.filter(Boolean))
}

const LANE = 15

/**
 * Objects over time: lanes of states, and a cursor at the frame.
 * @param lanes name, kind of the case, and its states: [state, first frame, last frame]; frames: of the run; pick(frame)
 */
export function timeStrip(lanes, frames, pick) {
  const step = (W - L - R) / Math.max(frames, 1), high = LANE * lanes.length, seen = new Set()
  const rows = lanes.map(({ name, kind, states }, k) => [
    make('text', { x: L - 4, y: LANE * k + 10, 'text-anchor': 'end' }, name),
    make('rect', { class: 'unseen', x: L, y: LANE * k + 2, width: W - L - R, height: LANE - 4 }),
    ...states.map(([state, first, last]) => {
      seen.add(state)
      return make('rect', { class: `${kind} ${state}`, x: L + step * first, y: LANE * k + 2, width: Math.max(step * (last + 1 - first), 1), height: LANE - 4 },
        make('title', {}, `${name}: ${state}, frame${first === last ? ` ${first}` : `s ${first} to ${last}`}`))
    }),
  ])
  const svg = make('svg', { class: 'time', viewBox: `0 0 ${W} ${high}`, role: 'img', 'aria-label': 'the object over time', style: `--step: ${step}px`,
    click: event => {
      const box = svg.getBoundingClientRect(), frame = Math.floor(((event.clientX - box.left) / box.width * W - L) / step)
      if (frame >= 0 && frame < frames) pick(frame)
    } }, ...rows.flat(), make('line', { class: 'cursor', x1: L, x2: L, y1: 0, y2: high }))
  return make('figure', {}, svg, make('figcaption', { class: 'short' }, [...seen, 'unseen'].map(state => key(`${lanes[0].kind} ${state}`, state))))
}

/** A number in the same digits as in all sentences (number in dynaviz/explain/words.py; a test compares them). */
export function short(value) {
  if (value === null || value === undefined) return ''
  const decimals = Number.isInteger(value) ? 0 : Math.min(Math.max(2 - Math.floor(Math.log10(Math.abs(value))), 0), 20)
  return value.toLocaleString('en', { maximumFractionDigits: decimals, roundingMode: 'halfEven' })
}
const signed = value => `${value < 0 ? '−' : '+'}${short(Math.abs(value))}`

const W = 340, L = 42, R = 6, TOP = 8, LINE = 74, BARS = 54, B = 16
const H = TOP + LINE + BARS + B

/**
 * The scans that touched points: above the quantity after each scan with its threshold, below what each added.
 * @param data as the server's strip; frames: of the run; on: hover(frame or null), pick(scan)
 */
export function scanStrip({ quantity, scans, points }, frames, on) {
  const step = (W - L - R) / Math.max(frames, 1), x = frame => L + step * frame
  const total = Boolean(quantity?.total), parts = [], text = (at, y, words, anchor, kind) => make('text', { x: at, y, 'text-anchor': anchor, class: kind }, words)
  const sum = scale(scans.map(scan => scan.value), [quantity?.threshold], TOP, TOP + LINE - 10)
  if (sum) {
    for (const value of sum.ends) parts.push(text(L - 4, sum.y(value) + 3, short(value), 'end'))
    if (quantity.threshold !== null) {
      const at = sum.y(quantity.threshold), near = scan => Math.abs((scan?.value ?? quantity.threshold) - quantity.threshold)
      const left = near(scans[0]) > near(scans.at(-1)) // where the curve is farther away
      parts.push(make('line', { x1: L, x2: W - R, y1: at, y2: at, class: 'threshold' }),
        text(left ? L + 2 : W - R, at + (at < TOP + 12 ? 10 : -3), `${quantity.bound === 'beyond' ? 'threshold' : `removed ${quantity.bound}`} ${short(quantity.threshold)}`, left ? 'start' : 'end', 'threshold'))
    }
    const known = scans.filter(scan => scan.value !== null)
    if (total) parts.push(make('path', { class: 'curve', d: known.map(({ frame, value }, k) => (k ? `H${x(frame).toFixed(1)}V` : `M${x(frame).toFixed(1)} `) + sum.y(value).toFixed(1)).join('') + `H${W - R}` }))
    else parts.push(known.map(({ frame, value, hit, crossed }) => make('circle', { cx: x(frame + 0.5), cy: sum.y(value), r: 2, class: kind(hit, crossed) })))
  }
  const base = TOP + LINE, middle = base + BARS / 2, most = Math.max(...scans.map(scan => Math.abs(scan.change ?? 0)), 1e-9)
  parts.push(make('line', { x1: L, x2: W - R, y1: middle, y2: middle, class: 'axis' }))
  for (const scan of scans) {
    const { hit, crossed, change, without_effect: idle } = scan
    const reach = total ? idle ? 0.28 : Math.abs(change) / most : Math.max(hit, crossed)
    if (!reach || !(hit || crossed || change)) continue
    const height = Math.max(2, reach * (BARS / 2 - 2)), down = total && !idle ? change < 0 : crossed > hit
    parts.push(make('rect', { x: x(scan.frame), width: Math.max(step - 0.6, 0.8), y: down ? middle : middle - height, height, class: `${kind(hit, crossed)}${idle ? ' idle' : ''}`, 'data-frame': scan.frame }))
  }
  if (total && scans.some(scan => scan.change)) parts.push(text(L - 4, middle - BARS / 2 + 10, signed(most), 'end'), text(L - 4, middle + BARS / 2 - 2, signed(-most), 'end'))
  parts.push(text(L, H - 4, 'frame 0', 'start'), text(W - R, H - 4, String(frames - 1), 'end'))
  const caption = make('figcaption', { 'aria-live': 'off' }), mark = make('rect', { class: 'hover', y: TOP, height: H - TOP - B, width: Math.max(step, 1), visibility: 'hidden' })
  const title = `${quantity ? quantity.name + (quantity.unit ? ` [${quantity.unit}]` : '') : 'rays'}${points > 1 ? `, median of ${whole(points)} points` : ''}`
  const say = words => caption.replaceChildren(...(words ? [words] : [title, ' ', key('hit', 'hit'), key('crossed', 'crossed'), scans.some(scan => scan.without_effect) && key('idle', 'without effect')].filter(Boolean)))
  say()
  const by = new Map(scans.map(scan => [scan.frame, scan]))
  const near = event => {
    const box = svg.getBoundingClientRect(), frame = Math.floor(((event.clientX - box.left) / box.width * W - L) / step)
    return by.get(frame) ?? [...by.values()].reduce((best, scan) => Math.abs(scan.frame - frame) < Math.abs((best?.frame ?? Infinity) - frame) ? scan : best, undefined)
  }
  let shown = null
  const show = scan => {
    if (scan === shown) return
    shown = scan
    mark.setAttribute('visibility', scan ? 'visible' : 'hidden')
    if (scan) mark.setAttribute('x', x(scan.frame))
    say(scan && words(scan, quantity, points))
    on.hover(scan?.frame ?? null)
  }
  const svg = make('svg', { class: 'strip', viewBox: `0 0 ${W} ${H}`, role: 'img', 'aria-label': `${title}, scan by scan`, tabindex: 0,
    mousemove: event => show(near(event)), mouseleave: () => show(null), click: event => { const scan = near(event); if (scan) on.pick(scan) } }, hatches(), mark, parts.flat())
  return make('figure', {}, svg, caption)
}

const kind = (hit, crossed) => crossed > hit ? 'crossed' : hit ? 'hit' : crossed ? 'crossed' : 'none'
const key = (name, words) => make('span', { class: `key ${name}` }, words)

function words(scan, quantity, points) {
  const touched = ['hit', 'crossed'].filter(name => scan[name]).map(name => points > 1 ? `${name} ${Math.round(100 * scan[name])} % of them` : name)
  const did = scan.without_effect ? ', without effect: clamped' : scan.change ? `, ${signed(scan.change)}` : ''
  const value = scan.value === null ? '' : `, ${quantity.name} ${quantity.legend[scan.value] ?? short(scan.value)}`
  return `Frame ${scan.frame}: ${touched.join(', ') || 'no ray'}${did}${value}`
}

/** Positions of values between two heights; null without values. */
function scale(values, more, top, bottom) {
  const known = values.filter(value => value !== null && value !== undefined)
  if (!known.length) return null
  const all = [...known, ...more.filter(value => value !== null && value !== undefined)]
  let [low, high] = [Math.min(...all), Math.max(...all)]
  if (low === high) [low, high] = [low - 1, high + 1]
  return { ends: [...new Set([Math.max(...known), Math.min(...known)])], y: value => top + (bottom - top) * (high - value) / (high - low) }
}

function hatches() {
  return make('defs', {}, ['hit', 'crossed'].map(name => make('pattern', { id: `hatch-${name}`, width: 3, height: 3, patternUnits: 'userSpaceOnUse', patternTransform: 'rotate(45)' },
    make('rect', { width: 1.3, height: 3, class: name }))))
}
