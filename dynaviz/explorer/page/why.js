// The panel on the right: the case in words, and why a point got its label.
import { ask, make, whole, words } from './dom.js'
import { runningTotal, short } from './plot.js'

const POLL = 400 // ms
const PATIENCE = 30 // seconds: a replay that takes longer waits for a click
const TITLES = { a: 'A', b: 'B' }

/** The chosen case. */
export function showCase(element, card, run, buttons, correction) {
  if (!card) {
    element.replaceChildren(make('h2', {}, 'No case'), make('p', {}, run.truth ? 'No labelled point is wrong.' : 'No cluster of removed points.'))
    return
  }
  const total = Object.values(card.reasons).reduce((sum, count) => sum + count, 0)
  const reasons = Object.entries(card.reasons).slice(0, 3).map(([name, count]) => `${words(name)} ${Math.round(100 * count / total)} %`).join(', ')
  const facts = { Cause: card.cost === null ? null : card.cause, Behaviour: card.behaviour, Reasons: reasons, 'Worst frame': String(card.worst) }
  element.replaceChildren(
    make('h2', { class: card.kind }, `${card.number} ${card.title}`),
    make('p', { class: 'sentence' }, card.sentence),
    make('dl', {}, Object.entries(facts).filter(([, value]) => value).flatMap(([name, value]) => [make('dt', {}, name), make('dd', {}, value)])),
    make('p', { class: 'buttons' }, buttons),
    ...(correction ? [correction] : []))
}

/** Explains one point at a time. */
export class PointPanel {
  /** @param element where; runs: facts by letter; drawn: called with a letter when its ledger is known. */
  constructor(element, runs, drawn) {
    this.element = element
    this.runs = runs
    this.drawn = drawn
    this.shown = null
    this.hint()
  }

  hint(text = 'Click a point in the viewer to see why it got its label.') {
    this.shown = null
    this.element.replaceChildren(make('h2', {}, 'Point'), make('p', { class: 'hint' }, text))
  }

  /** Show the truth, the answer and the reason of a point; then its ledger, at once if it was clicked and takes little time. */
  show(found, clicked) {
    this.shown = found
    const parts = Object.entries(found.runs).map(([letter, point]) => this.#part(letter, point, found, clicked))
    this.element.replaceChildren(make('h2', {}, `Point ${whole(found.point)} of frame ${found.frame}`), ...parts)
  }

  #part(letter, point, found, clicked) {
    const run = this.runs[letter], ledger = make('div', { class: 'ledger', 'data-run': letter })
    const wrong = point.outcome.startsWith('false')
    const part = make('section', { class: 'answer', 'data-outcome': point.outcome, 'data-run': letter },
      make('h3', {}, this.runs.b ? `${TITLES[letter]}: ${run.title}` : run.title),
      make('p', { class: 'sentence' }, point.sentence),
      make('dl', {},
        make('dt', {}, 'Truth'), make('dd', { class: 'truth' }, point.truth ?? 'unknown'),
        make('dt', {}, 'Answer'), make('dd', { class: `given${wrong ? ' wrong' : ''}` }, (point.removed ? 'removed' : 'kept') + (wrong ? ', wrong' : '')),
        make('dt', {}, 'Reason'), make('dd', { class: 'reason', 'data-reason': point.reason }, words(point.reason))),
      ledger)
    const start = () => this.#ledger(ledger, letter, found)
    if (clicked && (run.seconds ?? PATIENCE) < PATIENCE) start()
    else ledger.append(make('button', { type: 'button', class: 'start', click: start }, 'Show the scans that decided it'),
      make('p', { class: 'hint' }, `Repeats the run${run.seconds ? `, about ${Math.max(1, Math.round(run.seconds))} s` : ''}.`))
    return part
  }

  async #ledger(element, letter, found) {
    const bar = make('progress', { max: 1 }), text = make('p', { class: 'hint' }, 'Repeating the run …')
    element.replaceChildren(bar, text)
    try {
      for (;;) {
        const answer = await ask('why', { run: letter, frame: found.frame, point: found.point })
        if (this.shown !== found) return
        if (answer.error) throw new Error(answer.error)
        if (answer.why) {
          element.replaceChildren(...ledgerParts(answer.why))
          this.drawn(letter)
          return
        }
        if (answer.total) bar.value = answer.done / answer.total
        text.textContent = `Repeating the run: ${answer.phase}${answer.total ? `, ${answer.done} of ${answer.total}` : ''}`
        await new Promise(resolve => setTimeout(resolve, POLL))
      }
    } catch (error) {
      element.replaceChildren(make('p', { class: 'error' }, error.message))
    }
  }
}

/** Rules, the running total, and the scans. */
function ledgerParts({ ledger, rays, note }) {
  const frames = ledger.entries.map(entry => entry.frame)
  const plots = ledger.quantities.filter(quantity => quantity.total || quantity.threshold !== null)
    .map(({ name, unit, threshold }) => runningTotal(name, unit, frames, ledger.entries.map(entry => entry.values[name]), threshold))
  return [
    make('p', {}, rays), note && make('p', { class: 'hint' }, note),
    ledger.rules.length > 0 && make('ul', { class: 'rules' }, ledger.rules.map(rule => make('li', { class: rule.holds ? 'holds' : '' },
      make('b', {}, `${rule.name}: ${rule.holds ? 'yes, so it is removed' : 'no'}`),
      ` ${rule.terms.map(term => `${term.name} ${short(term.value) || '–'}${term.holds ? ' ' : ' not '}${term.test} ${short(term.threshold)}${term.unit ? ` ${term.unit}` : ''}`).join(' and ')}${rule.frame === null ? '' : ` (frame ${rule.frame})`}`))),
    ...plots.slice(0, 3),
    scanTable(ledger),
  ].filter(Boolean)
}

function scanTable(ledger) {
  const names = ledger.quantities, cell = (value, kind) => make('td', { class: kind }, value)
  const value = (entry, { name, legend, total }) => {
    const number = entry.values[name], change = entry.changes[name]
    if (number === null || number === undefined) return ''
    const shown = legend.length ? legend[number] ?? short(number) : short(number)
    return total && change ? `${shown} (${change > 0 ? '+' : '−'}${short(Math.abs(change))})` : shown
  }
  // What decided comes first: the panel may be too narrow for all columns.
  const head = ['frame', 'hit', 'crossed', ...names.map(({ name, unit }) => name + (unit ? ` [${unit}]` : '')), 'verdict', 'range', 'angle']
  const rows = ledger.entries.map(entry => make('tr', { class: [entry.frame === ledger.frame && 'own', entry.crossed ? 'crossed' : entry.hits && 'hit'].filter(Boolean).join(' '), title: `sensor at ${entry.sensor.map(x => x.toFixed(1)).join(' ')} m${entry.behind_m ? `; crossing rays end ${entry.behind_m.toFixed(1)} m behind` : ''}` },
    cell(entry.frame), cell(entry.hits || '', 'hits'), cell(entry.crossed || '', 'crosses'),
    ...names.map(name => cell(value(entry, name))), cell(entry.removed === null ? '' : entry.removed ? 'remove' : 'keep'),
    cell(`${entry.range_m.toFixed(1)} m`),
    cell(entry.angle_deg === null ? '' : `${entry.angle_deg.toFixed(0)}°`, entry.angle_deg !== null && entry.angle_deg < 10 && entry.crossed ? 'grazing' : null)))
  return make('div', { class: 'wide' }, make('table', {},
    make('thead', {}, make('tr', {}, head.map(name => make('th', { scope: 'col' }, name)))), make('tbody', {}, rows)))
}
