// Small plots, as inline SVG.
import { make } from './dom.js'

/** Wrong points over the frames of the run. */
export function sparkline(counts, worst, width = 150, height = 18) {
  const most = Math.max(...counts, 1), step = width / counts.length
  const bars = counts.map((count, k) => count && make('rect', {
    x: k * step, width: Math.max(step - 0.5, 0.5), y: height * (1 - Math.max(count / most, 0.08)), height: height * Math.max(count / most, 0.08),
    class: k === worst ? 'worst' : null,
  }))
  return make('svg', { class: 'spark', viewBox: `0 0 ${width} ${height}`, preserveAspectRatio: 'none', role: 'img', 'aria-label': 'wrong points over the frames' }, bars.filter(Boolean))
}

const W = 340, H = 110, L = 44, R = 8, T = 8, B = 18

/** A quantity after each scan, with its threshold. */
export function runningTotal(name, unit, frames, values, threshold) {
  const known = frames.map((frame, k) => [frame, values[k]]).filter(([, value]) => value !== null && value !== undefined)
  if (known.length < 2) return null
  const [first, last] = [known[0][0], known.at(-1)[0]]
  const heights = [...known.map(([, value]) => value), ...(threshold === null ? [] : [threshold])]
  let [low, high] = [Math.min(...heights), Math.max(...heights)]
  const pad = 0.08 * (high - low || 1)
  low -= pad
  high += pad
  const x = frame => L + (W - L - R) * (frame - first) / Math.max(last - first, 1)
  const y = value => T + (H - T - B) * (high - value) / (high - low)
  const steps = known.map(([frame, value], k) => (k ? `H${x(frame).toFixed(1)}V` : `M${x(frame).toFixed(1)} `) + y(value).toFixed(1)).join('')
  const label = (px, py, text, anchor, kind) => make('text', { x: px, y: py, 'text-anchor': anchor, class: kind }, text)
  const ticks = [Math.max(...known.map(([, value]) => value)), Math.min(...known.map(([, value]) => value))]
  return make('figure', {},
    make('figcaption', {}, `${name}${unit ? ` [${unit}]` : ''} after each scan`),
    make('svg', { class: 'total', viewBox: `0 0 ${W} ${H}`, role: 'img', 'aria-label': `${name} after each scan` },
      make('line', { x1: L, x2: W - R, y1: H - B, y2: H - B, class: 'axis' }),
      threshold !== null && make('line', { x1: L, x2: W - R, y1: y(threshold), y2: y(threshold), class: 'threshold' }),
      threshold !== null && label(W - R, y(threshold) - 3, `threshold ${short(threshold)}`, 'end', 'threshold'),
      make('path', { d: steps, class: 'curve' }),
      known.length <= 60 && known.map(([frame, value]) => make('circle', { cx: x(frame), cy: y(value), r: 1.8 })),
      [...new Set(ticks)].map(value => label(L - 4, y(value) + 3, short(value), 'end')),
      label(L, H - 5, `frame ${first}`, 'start'), label(W - R, H - 5, String(last), 'end')))
}

/** A number with at most three decimals. */
export const short = value => value === null || value === undefined ? '' : String(Number(value.toFixed(Math.abs(value) < 1 ? 3 : 2)))
