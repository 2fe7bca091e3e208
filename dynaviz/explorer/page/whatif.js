// What other parameters would change: the stored evidence of points is judged again, in the page.
import { make, whole } from './dom.js'
import { short } from './plot.js'

const logit = p => Math.fround(Math.log(p / (1 - p)))
const TESTS = { '<': (a, b) => a < b, '<=': (a, b) => a <= b, '>': (a, b) => a > b, '>=': (a, b) => a >= b }

/** How many of the points are removed with some values of the parameters. */
export function removedWith({ sums, points }, values) {
  return points.filter(point => {
    const totals = Object.fromEntries(sums.map(sum => [sum.name, total(sum, point.steps, values)]))
    return point.rules.some(({ holds, terms }) => terms.length ? terms.every(term => {
      const value = totals[term.name] ?? term.value, threshold = term.parameter ? values[term.parameter] : term.threshold
      return value !== null && threshold !== null && TESTS[term.test](value, threshold)
    }) : holds)
  }).length
}

/** A sum of log-odds over the scans; in single precision, as the method computes it. */
function total({ steps, limits }, scans, values) {
  const [low, high] = limits.length ? limits.map(name => logit(values[name])) : [-Infinity, Infinity]
  const added = steps.map(([name, parameter]) => [name, logit(values[parameter])])
  let sum = 0
  for (const applied of scans)
    for (const [name, change] of added)
      if (applied.includes(name)) sum = Math.min(Math.max(Math.fround(sum + change), low), high)
  return sum
}

/**
 * Sliders for the parameters that enter.
 * @param whatIf as the server's what_if; card: whose cost changes with the points, or null; start: called with the settings
 */
export function sliders(whatIf, card, start) {
  const given = Object.fromEntries(whatIf.parameters.map(({ name, value }) => [name, value])), values = { ...given }
  const before = removedWith(whatIf, given), all = whatIf.points.length
  const result = make('p', { class: 'result', role: 'status' }), go = make('button', { type: 'button', click: () => start(changed()) }, 'Run with this')
  const changed = () => Object.entries(values).filter(([name, value]) => value !== given[name])
  const update = () => {
    const removed = removedWith(whatIf, values), wrong = count => card.kind === 'ghost' ? all - count : count
    const counts = all === 1 ? `This point would be ${removed ? 'removed' : 'kept'}.` : `${whole(removed)} of ${whole(all)} points would be removed; ${whole(before)} are.`
    const cost = !card || card.cost === null || all === 1 || !wrong(before) ? '' : ` The case would cost ${(card.cost * wrong(removed) / wrong(before)).toFixed(2)} % of ${card.metric} instead of ${card.cost.toFixed(2)} %.`
    const any = changed().length > 0
    result.textContent = any ? `${counts}${cost} What else would change is unknown until a run.` : ''
    go.hidden = !any
  }
  const rows = whatIf.parameters.map(({ name, value, probability }) => {
    const whole = Number.isInteger(value) && !probability, shown = make('output', {}, short(value))
    const [min, max, step] = probability ? [0.01, 0.99, 0.01] : whole ? [0, Math.max(3 * value, 10), 1] : [0, 3 * value || 1, (3 * value || 1) / 100]
    const input = make('input', { type: 'range', name, min, max, step, value, 'aria-label': name, input: event => {
      values[name] = Math.abs(event.target.value - value) < step / 2 ? value : Number(event.target.value)
      shown.textContent = short(values[name])
      update()
    } })
    return make('label', {}, make('span', {}, name), input, shown)
  })
  update()
  return make('details', { class: 'sliders' }, make('summary', {}, 'What would flip it'), rows, result, go)
}
