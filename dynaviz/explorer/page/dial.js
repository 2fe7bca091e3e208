// The dial: what other parameters would change in the whole run, estimated from a sample of its points.
import { ask, make, say } from './dom.js'
import { short } from './plot.js'
import { served } from './server.js'

const WIDTH = 250, HEIGHT = 130, LEFT = 34, BOTTOM = 26, TOP = 8, RIGHT = 8
const LEAST = 4 // percent: the shortest axis

/** Sliders for parameters. input(values): called with those that differ. Without a server, only one differs at a time. */
export function sliderRows(parameters, input) {
  const values = Object.fromEntries(parameters.map(({ name, value }) => [name, value])), restored = []
  return parameters.map(({ name, value, low, high, step }) => {
    const shown = make('output', {}, short(value))
    const slider = make('input', { type: 'range', name, min: low, max: high, step, 'aria-label': name, input: event => {
      if (!served) for (const restore of restored) restore(name)
      values[name] = Math.abs(event.target.value - value) < step / 2 ? value : Number(event.target.value)
      shown.textContent = short(values[name])
      input(Object.fromEntries(parameters.filter(each => values[each.name] !== each.value).map(each => [each.name, values[each.name]])))
    } })
    slider.value = value
    restored.push(turned => {
      if (turned === name) return
      values[name] = slider.value = value
      shown.textContent = short(value)
    })
    return make('label', {}, make('span', {}, name), slider, shown)
  })
}

/** Calls a function with the latest of several values, one call at a time. */
export function latest(work) {
  let waiting = null, busy = false
  return async value => {
    waiting = { value }
    if (busy) return
    busy = true
    while (waiting) {
      const { value } = waiting
      waiting = null
      await work(value).catch(error => say(error.message))
    }
    busy = false
  }
}

/**
 * The dial of a run; nothing if its recording has no sample.
 * @param element where; letter: of the run; on: turned(costs of cases by number, or null as it ran), start(settings)
 */
export async function showDial(element, letter, on) {
  const given = await ask('dial', { run: letter, settings: '{}' })
  element.hidden = !given.parameters
  if (!given.parameters) return
  const trail = [given.scores], plot = make('div'), text = make('p', { class: 'result', role: 'status' })
  const go = make('button', { type: 'button', hidden: true, click: () => on.start(Object.entries(settings)) }, 'Run with this')
  let settings = {}
  const turn = latest(async values => {
    const turned = await ask('dial', { run: letter, settings: JSON.stringify(values) })
    settings = values
    trail.push(turned.scores)
    plot.replaceChildren(scorePlot(trail))
    text.textContent = turned.text
    const same = !Object.keys(values).length
    go.hidden = same || !served
    on.turned(same ? null : turned.cases)
  })
  plot.append(scorePlot(trail))
  element.replaceChildren(make('details', { class: 'sliders' }, make('summary', {}, 'What other parameters would change'), plot, sliderRows(given.parameters, turn), text, go))
}

/** DA over SA: a dot with whiskers, the run itself as a ring, and the way between them. */
function scorePlot(trail) {
  const last = trail.at(-1), axes = ['SA', 'DA'].filter(name => last[name])
  const [across, up] = axes.length === 2 ? axes : [axes[0], axes[0]]
  const ends = name => {
    const all = trail.flatMap(scores => [scores[name].value - scores[name].whisker, scores[name].value + scores[name].whisker])
    const [low, high] = [Math.min(...all), Math.max(...all)], spare = Math.max((LEAST - (high - low)) / 2, (high - low) * 0.08)
    return [Math.max(low - spare, 0), Math.min(high + spare, 100)]
  }
  const [left, right] = ends(across), [low, high] = ends(up)
  const x = value => LEFT + (WIDTH - LEFT - RIGHT) * (value - left) / (right - left), y = value => TOP + (HEIGHT - TOP - BOTTOM) * (high - value) / (high - low)
  const at = scores => [x(scores[across].value), y(scores[up].value)], [cx, cy] = at(last), [x0, y0] = at(trail[0])
  const reach = (name, sign) => last[name].value + sign * last[name].whisker
  const label = (at, place, words, anchor) => make('text', { x: at, y: place, 'text-anchor': anchor }, words)
  return make('svg', { class: 'dial', viewBox: `0 0 ${WIDTH} ${HEIGHT}`, role: 'img', 'aria-label': axes.map(name => `${name} ${last[name].value.toFixed(1)}`).join(', ') },
    make('line', { class: 'axis', x1: LEFT, x2: LEFT, y1: TOP, y2: HEIGHT - BOTTOM }), make('line', { class: 'axis', x1: LEFT, x2: WIDTH - RIGHT, y1: HEIGHT - BOTTOM, y2: HEIGHT - BOTTOM }),
    label(LEFT, HEIGHT - 14, left.toFixed(0), 'start'), label(WIDTH - RIGHT, HEIGHT - 14, right.toFixed(0), 'end'), label((LEFT + WIDTH) / 2, HEIGHT - 4, `${across} [%]`, 'middle'),
    label(LEFT - 4, TOP + 8, high.toFixed(0), 'end'), label(LEFT - 4, HEIGHT - BOTTOM, low.toFixed(0), 'end'), label(LEFT - 4, (TOP + HEIGHT - BOTTOM) / 2, up, 'end'),
    make('polyline', { class: 'trail', points: trail.map(scores => at(scores).join()).join(' ') }),
    make('line', { class: 'whisker', x1: x(reach(across, -1)), x2: x(reach(across, 1)), y1: cy, y2: cy }), make('line', { class: 'whisker', x1: cx, x2: cx, y1: y(reach(up, -1)), y2: y(reach(up, 1)) }),
    make('circle', { class: 'ran', cx: x0, cy: y0, r: 4 }), make('circle', { class: 'turned', cx, cy, r: 3.5 }))
}
