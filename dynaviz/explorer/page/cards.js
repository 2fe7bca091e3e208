// The cards of the cases: filters, order, and the list.
import { make, whole, words } from './dom.js'
import { sparkline } from './plot.js'

const RANGES = [['0-10', 0, 10], ['10-20', 10, 20], ['20-30', 20, 30], ['30-50', 30, 50], ['50+', 50, Infinity]]
const SORTS = { cost: 'costliest first', size: 'most points first', frame: 'by worst frame' }
const BY = { a: 'only A wrong', b: 'only B wrong', both: 'both wrong' }

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
const NAMES = { by: BY, kind: { ghost: 'ghosts (kept)', hole: 'holes (removed)', removed: 'removed' } }

/** All cases of one or two runs; of two, those of one object or place are one card, which has the other run's case as `other`. */
export function allCards(runs) {
  if (!runs.b) return runs.a.cases.map(card => ({ ...card, of: 'a' }))
  const shared = new Set(runs.a.cases.map(card => card.same))
  const list = runs.a.cases.map(card => ({ ...card, of: 'a', other: runs.b.cases.find(({ number }) => number === card.same) }))
  const alone = runs.b.cases.filter(card => !shared.has(card.number) && card.by !== 'both').map(card => ({ ...card, of: 'b' }))
  return [...list, ...alone].map(card => ({ ...card, by: card.other || card.by === 'both' ? 'both' : card.of }))
}

export const worth = card => Math.max(card.cost ?? card.suspicion ?? card.points, card.other?.cost ?? 0)
const ORDER = { cost: (a, b) => worth(b) - worth(a) || a.number - b.number, size: (a, b) => b.points - a.points, frame: (a, b) => a.worst - b.worst }

/** The cards that pass the filters of a state, in its order. */
export function chosen(cards, state) {
  const search = (state.search ?? '').toLowerCase().split(/\s+/).filter(Boolean)
  const text = card => `${card.title} ${card.sentence} ${card.cause ?? ''} ${card.behaviour ?? ''} ${Object.keys(card.reasons).join(' ')}`.toLowerCase()
  return cards
    .filter(card => Object.entries(FILTERS).every(([name, [, values]]) => !state[name] || values(card).includes(state[name])))
    .filter(card => search.every(word => text(card).includes(word)))
    .sort(ORDER[state.sort] ?? ORDER.cost)
}

/** The form of filters; only those with a choice are shown. */
export function filters(form, cards, state, changed) {
  const options = Object.entries(FILTERS).map(([name, [label, values]]) => {
    const counts = new Map()
    for (const card of cards) for (const value of values(card)) if (value) counts.set(value, (counts.get(value) ?? 0) + 1)
    if (counts.size < 2) return null
    const order = name === 'range' ? RANGES.map(([value]) => value).filter(value => counts.has(value)) : [...counts.keys()].sort((a, b) => counts.get(b) - counts.get(a))
    const entries = order.map(value => make('option', { value, selected: state[name] === value }, `${NAMES[name]?.[value] ?? words(value)} (${counts.get(value)})`))
    return make('select', { name, 'aria-label': label, change: changed }, make('option', { value: '' }, label), entries)
  })
  const sorts = Object.entries(SORTS).map(([value, label]) => make('option', { value, selected: (state.sort ?? 'cost') === value }, label))
  const truth = cards.some(card => card.cost !== null)
  if (!truth) sorts[0].textContent = cards.some(differs) ? 'largest first' : 'most suspicious first'
  form.replaceChildren(
    make('input', { type: 'search', name: 'search', placeholder: 'Search', 'aria-label': 'Search', value: state.search ?? '', input: changed }),
    make('select', { name: 'sort', 'aria-label': 'Order', change: changed }, sorts),
    ...options.filter(Boolean))
  form.onsubmit = event => event.preventDefault()
}

/** Whether a case is a difference between two drives, which nothing makes suspicious. */
export const differs = card => card.cost === null && card.suspicion === null
const chip = card => differs(card) ? `${card.points.toLocaleString('en')} points` : card.cost === null ? `suspicion ${card.suspicion.toFixed(2)}` : `−${card.cost.toFixed(2)} % ${card.metric}`
/** What a case costs each of two runs, as bars. */
function costs(card, most) {
  const of = { [card.of]: card, [card.of === 'a' ? 'b' : 'a']: card.other }
  return ['a', 'b'].map(letter => make('p', { class: 'cost-of' }, letter.toUpperCase(), make('span', { class: 'bar', style: `--share: ${Math.max(worth(of[letter] ?? { cost: 0 }) / most, 0)}` }), of[letter] ? chip(of[letter]) : card.by === 'both' ? 'wrong, too' : 'right'))
}

const span = card => card.first === card.last ? `frame ${card.first}` : `frames ${card.first}–${card.last}`

/** A card: what, what it costs, why, where and when; of two runs with the cost of each, `most` for the longest bar. */
export function cardElement(card, frames, most, open, corrected) {
  const bins = card.spark.length, worst = Math.floor(card.worst * bins / Math.max(frames, 1))
  return make('li', { id: `card-${card.of}-${card.number}`, class: `card ${card.kind}`, tabindex: 0, click: () => open(card), keydown: event => event.key === 'Enter' && open(card) },
    make('img', { src: `api/drawing?run=${card.of}&case=${card.number}&width=168&height=108`, width: 84, height: 54, alt: '', loading: 'lazy' }),
    make('div', {},
      make('p', { class: 'head' }, `${card.number} ${card.title}`),
      make('p', { class: 'cause' }, !most && make('span', { class: 'cost' }, `${chip(card)} `), `${card.cause ?? Object.keys(card.reasons).slice(0, 2).map(words).join(', ')}`),
      make('p', { class: 'where', title: `${whole(card.points)} points` }, `${card.range.toFixed(0)} m away, ${span(card)}`),
      corrected && make('p', { class: 'by' }, `corrected: ${corrected}`),
      most && costs(card, most), most && make('p', { class: 'by' }, BY[card.by]),
      sparkline(card.spark, worst)))
}
