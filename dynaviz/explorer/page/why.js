// The panel on the right: the case in words, and why a point got its label.
import { ask, make, say, whole, words } from './dom.js'
import { scanStrip, short, timeStrip } from './plot.js'
import { caseMap } from './rectangle.js'
import { served } from './server.js'
import { sliders } from './whatif.js'

const POLL = 400 // ms
const PATIENCE = 30 // seconds: a replay that takes longer waits for a click

const LANES = { truth: ['moving', 'standing'], looks: ['hit', 'through', 'hidden'], rays: ['hit', 'crossed'], answer: ['kept', 'partly', 'removed'] }

/** The lanes of a case: its object, the looks at its place (of earlier runs, the rays that met it), and the answer of each run. */
function lanesOf(card, runs, rays) {
  const lane = (name, from, spans) => ({ name, kind: card.kind, states: LANES[from].flatMap(state => (spans?.[state] ?? []).map(span => [state, ...span])) })
  const { moving = [], standing = [] } = card.spans
  const right = card.kind === 'ghost' ? { removed: [...moving, ...standing] } : undefined
  const spans = letter => letter === card.of ? card.spans : card.others[letter]?.spans ?? (card.by.includes(letter) ? undefined : right)
  const answers = Object.keys(runs).map(letter => lane(runs.b ? letter.toUpperCase() : 'answer', 'answer', spans(letter)))
  const looks = lane('looks', 'looks', card.spans)
  return [lane('object', 'truth', card.spans), looks.states.length ? looks : lane('rays', 'rays', rays), ...answers].filter(({ states }) => states.length)
}

/** The chosen case; its evidence follows when it was read. on: by letter and the rows of chosen points, if not all, as for PointPanel; goTo: a frame; pick: explain the point in a row of its scan. */
export function showCase(element, card, runs, buttons, correction, on, goTo, pick) {
  const run = runs[card?.of ?? 'a']
  if (!card) {
    element.replaceChildren(make('h2', {}, 'No case'), make('p', {}, run.truth ? 'No labelled point is wrong.' : run.compares ? 'Nothing appeared or disappeared.' : 'No cluster of removed points.'))
    return
  }
  const total = Object.values(card.reasons).reduce((sum, count) => sum + count, 0)
  const reasons = Object.entries(card.reasons).slice(0, 3).map(([name, count]) => `${words(name)} ${Math.round(100 * count / total)} %`).join(', ')
  const facts = { Cause: card.cost === null ? null : card.cause, Reasons: reasons, 'Worst frame': String(card.worst) }
  const evidence = make('div', { class: 'ledger' }), time = make('div')
  const overTime = rays => {
    const lanes = lanesOf(card, runs, rays)
    time.replaceChildren(...(lanes.length ? [timeStrip(lanes, run.frames, goTo)] : []))
  }
  overTime()
  element.replaceChildren(...[
    make('h2', { class: card.kind }, `${card.number} ${card.title}`),
    make('p', { class: 'sentence' }, card.sentence),
    ...Object.entries(card.others).map(([letter, other]) => make('p', { class: 'sentence' }, `${letter.toUpperCase()}: ${other.sentence}`)),
    time,
    make('dl', {}, Object.entries(facts).filter(([, value]) => value).flatMap(([name, value]) => [make('dt', {}, name), make('dd', {}, value)])),
    evidence,
    make('p', { class: 'buttons' }, buttons),
    correction].filter(Boolean))
  ask('evidence', { run: card.of, case: card.number }).then(found => {
    if (!found.strip) return
    overTime(found.spans)
    const strip = make('div', { class: 'ledger' }), flip = make('div')
    const show = ({ text, strip: scans, what_if: whatIf }, points) => {
      strip.replaceChildren(make('p', { class: 'evidence' }, text), scanStrip(scans, run.frames, on(card.of, points)))
      flip.replaceChildren(...(whatIf ? [sliders(whatIf, { run: card.of, case: card.number, ...(points && { points }) }, points ? null : card, settings => on(card.of).start(settings))] : []))
    }
    show(found)
    let latest // of several rectangles, the last one counts
    const choose = async points => {
      latest = points
      const chosen = points ? await ask('evidence', { run: card.of, case: card.number, points }) : found
      if (latest === points) show(chosen, points)
    }
    evidence.append(strip, caseMap(found.map, points => choose(points).catch(error => say(error.message)), pick), flip)
  }, error => evidence.append(make('p', { class: 'error' }, error.message)))
}

/** Explains one point at a time. */
export class PointPanel {
  /** @param element where; runs: facts by letter; drawn: called with a letter when its ledger is known; on: by letter, hover(frame), pick(scan), start(settings). */
  constructor(element, runs, drawn, on) {
    this.element = element
    this.runs = runs
    this.drawn = drawn
    this.on = on
    this.shown = null
    this.hint()
  }

  hint(text = served ? 'Click a point in the viewer to see why it got its label.' : 'Click a large point of a case to see why it got its label.') {
    this.shown = null
    this.element.replaceChildren(make('h2', {}, 'Point'), make('p', { class: 'hint' }, text))
  }

  /** Whether a ledger is shown. */
  get open() { return Boolean(this.element.querySelector('.ledger figure')) }

  /** Mention a point that is right, and leave the ledger of another one open. */
  mention(found, explain) {
    this.element.querySelector('.mention')?.remove()
    const { sentence, reason } = Object.values(found.runs)[0]
    this.element.prepend(make('p', { class: 'mention reason', 'data-reason': reason }, `Point ${whole(found.point)} of frame ${found.frame}: ${sentence} `,
      make('button', { type: 'button', click: explain }, 'Why')))
  }

  /** Show the truth, the answer and the reason of a point; then its ledger, at once if it is stored, or if it was clicked and takes little time. */
  show(found, clicked) {
    this.shown = found
    const parts = Object.entries(found.runs).map(([letter, point]) => this.#part(letter, point, found, clicked))
    this.element.replaceChildren(make('h2', {}, `Point ${whole(found.point)} of frame ${found.frame}`), ...parts.map(([part]) => part))
    return Promise.all(parts.map(([, ready]) => ready))
  }

  #part(letter, point, found, clicked) {
    const run = this.runs[letter], ledger = make('div', { class: 'ledger', 'data-run': letter })
    const wrong = point.outcome.startsWith('false')
    const part = make('section', { class: 'answer', 'data-outcome': point.outcome, 'data-run': letter },
      make('h3', {}, this.runs.b ? `${letter.toUpperCase()}: ${run.title}` : run.title),
      make('p', { class: 'sentence' }, point.sentence),
      make('dl', {},
        make('dt', {}, 'Truth'), make('dd', { class: 'truth' }, (point.truth ?? 'unknown') + (point.corrected ? ', corrected' : '')),
        make('dt', {}, 'Answer'), make('dd', { class: `given${wrong ? ' wrong' : ''}` }, point.answer + (wrong ? ', wrong' : '')),
        make('dt', {}, 'Reason'), make('dd', { class: 'reason', 'data-reason': point.reason }, words(point.reason))),
      ledger)
    return [part, run.compares || this.#stored(ledger, letter, found, clicked)]
  }

  /** The stored ledger, or the offer to repeat the run. */
  async #stored(element, letter, found, clicked) {
    try {
      const answer = await ask('why', { run: letter, frame: found.frame, point: found.point })
      if (this.shown !== found) return
      if (answer.why) this.#fill(element, letter, found, answer)
      else if (!served) element.replaceChildren(make('p', { class: 'hint' }, 'No evidence is stored on this point.'))
      else if (clicked && (answer.seconds ?? PATIENCE) < PATIENCE) this.#replay(element, letter, found)
      else element.replaceChildren(this.#offer(element, letter, found, 'Show the scans that decided it', answer.seconds))
    } catch (error) {
      element.replaceChildren(make('p', { class: 'error' }, error.message))
    }
  }

  #offer(element, letter, found, label, seconds) {
    return make('p', { class: 'hint' }, make('button', { type: 'button', class: 'start', click: () => this.#replay(element, letter, found) }, label),
      ` Repeats the run${seconds ? `, about ${Math.max(1, Math.round(seconds))} s` : ''}.`)
  }

  #fill(element, letter, found, { why, metres }) {
    element.replaceChildren(...this.#ledgerParts(letter, why))
    if (metres) element.prepend(make('p', { class: 'hint' }, `Evidence on a point ${metres.toFixed(2)} m away, with the same label for the same reason. `,
      served && make('button', { type: 'button', class: 'start', click: () => this.#replay(element, letter, found) }, 'Repeat the run for this one')))
    this.drawn(letter)
  }

  async #replay(element, letter, found) {
    const bar = make('progress', { max: 1 }), text = make('p', { class: 'hint' }, 'Repeating the run …')
    element.replaceChildren(bar, text)
    try {
      for (;;) {
        const answer = await ask('why', { run: letter, frame: found.frame, point: found.point, exact: 1 })
        if (this.shown !== found) return
        if (answer.error) throw new Error(answer.error)
        if (answer.why) return this.#fill(element, letter, found, answer)
        if (answer.share) bar.value = answer.share
        text.textContent = `Repeating the run${answer.seconds ? `: about ${Math.ceil(answer.seconds)} s left` : ' …'}`
        await new Promise(resolve => setTimeout(resolve, POLL))
      }
    } catch (error) {
      element.replaceChildren(make('p', { class: 'error' }, error.message))
    }
  }

  /** What decided, the strip of scans, what would flip it; the other rules and all scans are folded. */
  #ledgerParts(letter, { ledger, evidence, note, strip, what_if: whatIf, decided, deciding }) {
    const on = this.on(letter), first = ledger.rules.find(rule => rule.name === decided), rest = ledger.rules.filter(rule => rule !== first)
    return [
      make('p', { class: 'evidence' }, evidence), note && make('p', { class: 'hint' }, note),
      first && make('ul', { class: 'rules' }, ruleElement(first)),
      strip.scans.length > 0 && scanStrip(strip, this.runs[letter].frames, on),
      deciding.length > 0 && decidingTable(deciding, ledger.frame),
      whatIf && sliders(whatIf, { run: letter, frame: ledger.frame, point: ledger.point }, null, on.start),
      rest.length > 0 && make('details', {}, make('summary', {}, `${rest.length} other rule${rest.length > 1 ? 's' : ''}`), make('ul', { class: 'rules' }, rest.map(ruleElement))),
      make('details', {}, make('summary', {}, `All ${ledger.entries.length} scans`), scanTable(ledger)),
    ].filter(Boolean)
  }
}

function ruleElement(rule) {
  return make('li', { class: rule.holds ? 'holds' : '' }, make('b', {}, rule.holds ? 'Yes, so it is removed.' : 'No.'), ` ${rule.text}`)
}

/** The scans that decided, equal ones together, as the server words them. */
function decidingTable(rows, own) {
  const cell = (value, kind) => make('td', { class: kind }, value)
  return make('table', { class: 'deciding' },
    make('thead', {}, make('tr', {}, ['frames', 'hit', 'crossed', 'what it showed', 'so far'].map(name => make('th', { scope: 'col' }, name)))),
    make('tbody', {}, rows.map(({ frames, span, hits, crossed, text, removed }) => make('tr', { class: frames[0] === own ? 'own' : null },
      cell(span), cell(hits || '', 'hits'), cell(crossed || '', 'crosses'), cell(text, 'text'), cell(removed === null ? '' : removed ? 'removed' : 'kept')))))
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
    cell(entry.angle_deg === null ? '' : `${entry.angle_deg.toFixed(0)}°`, entry.angle_deg !== null && entry.angle_deg < 20 && entry.crossed ? 'grazing' : null)))
  return make('div', { class: 'wide' }, make('table', {},
    make('thead', {}, make('tr', {}, head.map(name => make('th', { scope: 'col' }, name)))), make('tbody', {}, rows)))
}
