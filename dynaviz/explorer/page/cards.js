// The cards of the cases: filters, order, and the list.
import { make, whole, words } from './dom.js'
import { sparkline } from './plot.js'
import { drawing } from './server.js'

const RANGES = [['0-10', 0, 10], ['10-20', 10, 20], ['20-30', 20, 30], ['30-50', 30, 50], ['50+', 50, Infinity]]
const SORTS = { cost: 'costliest first', size: 'most points first', frame: 'by worst frame' }

/** Of each filter its label, and the values of a case. */
const FILTERS = {
  by: ['Wrong in', card => [card.by]],
  kind: ['Ghost or hole', card => [card.kind]],
  cause: ['Cause', card => [card.cause ?? 'unknown']],
  what: ['Class', card => [card.what || 'unknown']],
  range: ['Range [m]', card => [RANGES.find(([, low, high]) => card.range >= low && card.range < high)?.[0]]],
  reason: ['Reason', card => Object.keys(card.reasons)],
  object: ['Object', card => [card.object]],
}
const NAMES = { kind: { ghost: 'ghosts (kept)', hole: 'holes (removed)', removed: 'removed' } }

/** All cases of the runs; those of one object or place are one card, which has the cases of the other runs as `others`, by letter. */
export function allCards(runs) {
  const letters = Object.keys(runs), used = new Set(), list = []
  for (const of of letters) for (const card of runs[of].cases) {
    if (used.has(of + card.number) || card.wrong.some(letter => letter < of)) continue
    const others = {}
    for (const [letter, number] of Object.entries(card.same)) {
      if (letter < of || used.has(letter + number)) continue
      used.add(letter + number)
      others[letter] = runs[letter].cases.find(other => other.number === number)
    }
    list.push({ ...card, of, others, by: letters.filter(letter => letter === of || others[letter] || card.wrong.includes(letter)).join('') })
  }
  return list
}

/** Which of the runs are wrong, in words. */
const wrongIn = (by, count) => by.length < count ? `only ${[...by.toUpperCase()].join(', ')} wrong` : count === 2 ? 'both wrong' : 'all wrong'

/** What orders the cases, as in the run itself: their cost, or without ground truth their suspicion times their points; of changes, their points. */
export const worth = card => Math.max(...[card, ...Object.values(card.others ?? {})].map(({ cost, suspicion, points }) => cost ?? (suspicion ?? 1) * points))
const ORDER = { cost: (a, b) => worth(b) - worth(a) || a.number - b.number, size: (a, b) => b.points - a.points, frame: (a, b) => a.worst - b.worst }

/** The cards that pass the filters of a state, in its order; turned: what cases would cost with other parameters, by number. */
export function chosen(cards, state, turned) {
  const search = (state.search ?? '').toLowerCase().split(/\s+/).filter(Boolean)
  const text = card => `${card.title} ${card.sentence} ${card.cause ?? ''} ${card.behaviour ?? ''} ${Object.keys(card.reasons).join(' ')}`.toLowerCase()
  return cards
    .filter(card => Object.entries(FILTERS).every(([name, [, values]]) => !state[name] || values(card).includes(state[name])))
    .filter(card => search.every(word => text(card).includes(word)))
    .sort(turned && (state.sort ?? 'cost') === 'cost' ? (a, b) => would(b, turned) - would(a, turned) || a.number - b.number : ORDER[state.sort] ?? ORDER.cost)
}

/** What a case would cost; as now, if its recording does not say. */
const would = (card, turned) => turned[card.number] ?? worth(card)

/** The form of filters; only those with a choice are shown. */
export function filters(form, cards, runs, state, changed) {
  const options = Object.entries(FILTERS).map(([name, [label, values]]) => {
    const counts = new Map()
    for (const card of cards) for (const value of values(card)) if (value) counts.set(value, (counts.get(value) ?? 0) + 1)
    if (counts.size < 2) return null
    const order = name === 'range' ? RANGES.map(([value]) => value).filter(value => counts.has(value)) : [...counts.keys()].sort((a, b) => counts.get(b) - counts.get(a))
    const entries = order.map(value => make('option', { value, selected: state[name] === value }, `${name === 'by' ? wrongIn(value, Object.keys(runs).length) : NAMES[name]?.[value] ?? words(value)} (${counts.get(value)})`))
    return make('select', { name, 'aria-label': label, change: changed }, make('option', { value: '' }, label), entries)
  })
  const sorts = Object.entries(SORTS).map(([value, label]) => make('option', { value, selected: (state.sort ?? 'cost') === value }, label))
  const truth = cards.some(card => card.cost !== null)
  if (!truth) sorts[0].textContent = cards.some(differs) ? 'largest first' : 'by suspicion'
  form.replaceChildren(
    make('input', { type: 'search', name: 'search', placeholder: 'Search', 'aria-label': 'Search', value: state.search ?? '', input: changed }),
    make('select', { name: 'sort', 'aria-label': 'Order', change: changed }, sorts),
    ...options.filter(Boolean))
  form.onsubmit = event => event.preventDefault()
}

/** Whether a case is a difference between two drives, which nothing makes suspicious. */
export const differs = card => card.cost === null && card.suspicion === null
const chip = card => differs(card) ? `${whole(card.points)} points` : card.cost === null ? `suspicion ${card.suspicion.toFixed(2)} × ${whole(card.points)} points` : `−${card.cost.toFixed(2)} % ${card.metric}`
/** What a case costs each run, as bars. */
const costs = (card, runs, most) => Object.keys(runs).map(letter => {
  const own = letter === card.of ? { ...card, others: {} } : card.others[letter]
  return make('p', { class: 'cost-of', title: runs[letter].title }, letter.toUpperCase(), make('span', { class: 'bar', style: `--share: ${own ? Math.max(worth(own) / most, 0) : 0}` }), own ? chip(own) : card.by.includes(letter) ? 'wrong, too' : 'right')
})

const span = card => card.first === card.last ? `frame ${card.first}` : `frames ${card.first}–${card.last}`

/** A card: what, what it costs, why, where and when; of several runs with the cost of each, `most` for the longest bar; cost: with other parameters. */
export function cardElement(card, runs, most, open, corrected, cost) {
  const { frames } = runs.a, several = Boolean(runs.b)
  const bins = card.spark.length, worst = Math.floor(card.worst * bins / Math.max(frames, 1))
  return make('li', { id: `card-${card.of}-${card.number}`, class: `card ${card.kind}`, tabindex: 0, click: () => open(card), keydown: event => event.key === 'Enter' && open(card) },
    make('img', { src: drawing({ run: card.of, case: card.number, width: 168, height: 108 }), width: 84, height: 54, alt: '', loading: 'lazy' }),
    make('div', {},
      make('p', { class: 'head' }, `${card.number} ${card.title}`),
      make('p', { class: 'cause' }, !several && make('span', { class: 'cost' }, `${chip(card)} `), `${card.cause ?? Object.keys(card.reasons).slice(0, 2).map(words).join(', ')}`),
      make('p', { class: 'where', title: `${whole(card.points)} points` }, `${card.range.toFixed(0)} m away, ${span(card)}`),
      cost !== undefined && make('p', { class: `would ${cost < card.cost ? 'better' : cost > card.cost ? 'worse' : ''}` }, `would cost −${cost.toFixed(2)} % ${card.metric}`),
      corrected && make('p', { class: 'by' }, `corrected: ${corrected}`),
      several && costs(card, runs, most), several && make('p', { class: 'by' }, wrongIn(card.by, Object.keys(runs).length)),
      sparkline(card.spark, worst)))
}
