// The review of a run: one place after another, one key for each decision.
import { ask, make, say, send, whole } from './dom.js'
import { drawTime, Places } from './places.js'

const by = id => document.getElementById(id)
const LETTER = new URLSearchParams(location.search).get('run') ?? 'a'
const KEYS = {
  k: 'keep: it is static', r: 'remove: it moved', x: 'cannot tell', s: 'skip', u: 'undo', n: 'next place', p: 'previous place',
  '← →': 'one frame back, one on', f: 'boxes count from this frame on, or at all times', t: 'turn the views from the side', Escape: 'remove the box',
  w: 'write the map', '/': 'search', '?': 'these keys',
}
const SORTS = { expected: c => -c.expected, wrong: c => -c.wrong, points: c => -c.points, first: c => c.first }
const VERDICT = { static: 'keep', dynamic: 'remove', undecided: 'cannot tell' }

let all, shown = [], at = null, place = null, frame = 0, onwards = false, decisions = [], places, looked = new Set(), busy = Promise.resolve()
let balance = { kept: 0, removed: 0 }

async function start() {
  for (all = await ask('review', { run: LETTER }); !all.candidates; all = await ask('review', { run: LETTER })) {
    if (all.error) return by('question').textContent = all.error
    by('question').textContent = `${all.phase} ${all.total ? `${all.done} of ${all.total}` : ''}`
    await new Promise(resolve => setTimeout(resolve, 300))
  }
  document.title = `Review of ${all.title} on ${all.sequence}`
  by('run').textContent = `${all.title}: ${all.sequence}`
  places = new Places(by('views'), tool)
  for (const [key, text, verdict] of [['k', 'Keep', 'static'], ['r', 'Remove', 'dynamic'], ['x', 'Cannot tell', 'undecided'], ['s', 'Skip'], ['u', 'Undo'], ['f', 'From this frame on'], ['w', 'Write the map']])
    by('actions').append(make('button', { type: 'button', id: `do-${key}`, 'data-verdict': verdict, click: () => ACTIONS[key]() }, make('kbd', {}, key), ` ${text}`))
  by('help').append(make('h2', {}, 'Keys'), make('dl', {}, Object.entries(KEYS).flatMap(([key, text]) => [make('dt', {}, make('kbd', {}, key)), make('dd', {}, text)])),
    make('p', {}, 'Drag a rectangle from above and one from the side: together they are a box, and keys decide about the box.'), make('form', { method: 'dialog' }, make('button', {}, 'Close')))
  by('out').value = all.out
  by('reviewer').value = new URLSearchParams(location.search).get('reviewer') ?? ''
  by('filters').addEventListener('input', list)
  by('filters').onsubmit = event => event.preventDefault()
  const time = by('time').appendChild(make('canvas', { 'aria-label': 'frames', click: event => seek(Math.floor(event.offsetX / time.clientWidth * all.frames)) }))
  update(all)
  const first = shown.find(each => !verdictOf(each))
  await open(first ?? shown[0])
  document.body.dataset.ready = 'review'
}

const verdictOf = candidate => decisions.findLast(each => each.key === candidate.key)?.verdict

/** What the server says of the decisions. */
function update(answer) {
  decisions = answer.decisions
  balance = { kept: answer.kept, removed: answer.removed }
  const decided = all.candidates.filter(verdictOf).length, about = all.step > 1 ? 'about ' : ''
  for (const each of all.candidates) if (verdictOf(each)) looked.add(each.number)
  by('progress').textContent = `${all.candidates.length} places to look at; the first ${all.worth} are worth it. ${looked.size} looked at, ${decided} decided.`
  by('balance').textContent = `${about}+${whole(answer.kept)} points kept, −${whole(answer.removed)} removed by ${decisions.length} decision${decisions.length === 1 ? '' : 's'}`
  list()
}

function list() {
  const { search, answered, state, sort } = Object.fromEntries(new FormData(by('filters')))
  const words = search.toLowerCase().split(/\s+/).filter(Boolean)
  shown = all.candidates
    .filter(each => !answered || each.answered === answered)
    .filter(each => !state || (state === 'decided') === Boolean(verdictOf(each)))
    .filter(each => words.every(word => `${each.number} ${each.title} ${each.answered}`.toLowerCase().includes(word)))
  if (sort !== 'expected') shown = shown.toSorted((a, b) => SORTS[sort](a) - SORTS[sort](b))
  by('count').textContent = `${shown.length === all.candidates.length ? '' : `${shown.length} of `}${all.candidates.length} places`
  by('cards').replaceChildren(...shown.map(card))
  highlight()
}

function card(each) {
  const verdict = verdictOf(each)
  return make('li', { id: `card-${each.number}`, class: `card ${each.answered}`, tabindex: 0, click: () => open(each) },
    verdict && make('span', { class: `verdict ${verdict}` }, VERDICT[verdict]),
    make('p', { class: 'head' }, `${each.number} ${each.answered}, ${whole(each.points)} points`),
    make('p', { class: 'cause' }, make('span', { class: 'cost' }, `${Math.round(100 * each.wrong)} % wrong `), each.title),
    make('p', { class: 'where' }, span(each)))
}

const span = ({ first, last }) => first === last ? `frame ${first}` : `frames ${first}–${last}`

function highlight() {
  document.querySelector('.card[aria-current]')?.removeAttribute('aria-current')
  const element = at && by(`card-${at.number}`)
  element?.setAttribute('aria-current', 'true')
  element?.scrollIntoView({ block: 'nearest' })
}

let waited = 0
/** Show a place; of several on their way, the last one counts. */
async function open(candidate) {
  if (!candidate) return by('question').textContent = 'No place is left to look at.'
  const mine = ++waited
  at = candidate
  highlight()
  const query = { run: LETTER, candidate: candidate.number }
  const [found, points] = await Promise.all([ask('review_place', query), ask('review_points', query)])
  if (mine !== waited) return
  place = found
  frame = found.best
  places.frame = frame
  places.show(found, new Float32Array(points), candidate.answered)
  describe()
  document.body.dataset.place = candidate.number
}

/** The same place with its decisions. */
async function again() {
  const candidate = at, points = await ask('review_points', { run: LETTER, candidate: at.number })
  if (candidate !== at) return
  places.show(place, new Float32Array(points), at.answered)
  describe()
}

function describe() {
  const verdict = verdictOf(at)
  by('question').className = at.answered
  by('question').textContent = at.answered === 'kept' ? `${at.number}. Kept. Is it a mover?` : `${at.number}. Removed. Is it static?`
  by('facts').textContent = `${whole(at.points)} points in ${span(at)}, ${at.title}. This answer is wrong with a probability of ${Math.round(100 * at.wrong)} %.${verdict ? ` Decided: ${VERDICT[verdict]}.` : ''}`
  for (const button of document.querySelectorAll('#actions button[data-verdict]')) button.setAttribute('aria-pressed', button.dataset.verdict === verdict)
  seek(frame)
}

function seek(to) {
  frame = Math.min(Math.max(to, 0), all.frames - 1)
  places.frame = frame
  places.draw()
  drawTime(by('time').firstChild, place, frame)
  tool()
}

function tool() {
  const box = places.box
  by('do-f').setAttribute('aria-pressed', onwards)
  if (!box) {
    by('tool').textContent = `Frame ${frame}: ${place.points[frame]} points of the place; orange or pink: its points over the frames, violet: the share that rays passed through. Drag a rectangle to decide about a part.`
    return
  }
  const { points, removed } = places.inside(onwards ? frame : 0), size = box[1].map((value, k) => (value - box[0][k]).toFixed(1)).join(' × ')
  by('tool').textContent = `Box of ${size} m ${onwards ? `from frame ${frame} on` : 'at all times'}: ${whole(points)} points drawn, ${whole(removed)} of them removed. k keeps them, r removes them.`
}

/** One after the other, so that quick keys are not lost. */
const queue = work => { busy = busy.then(work).catch(error => say(error.message)) }

const said = () => ({ reviewer: by('reviewer').value, reason: by('reason').value })

function decide(verdict) {
  queue(async () => {
    const box = places.box, query = { run: LETTER, candidate: at.number, verdict, ...said() }
    if (box) Object.assign(query, { low: box[0], high: box[1], ...(onwards && { first: frame }) })
    const next = following()
    update(await send('decide', query))
    by('reason').value = ''
    if (box) await again()
    else await open(next ?? at)
    if (!box && !next) say('This was the last open place: press w to write the map.')
  })
}

/** The next place that is open, after this one in the list. */
const following = () => shown.slice(shown.indexOf(at) + 1).find(each => !verdictOf(each))

function step(by) {
  queue(() => {
    const next = shown[Math.min(Math.max(shown.indexOf(at) + by, 0), shown.length - 1)]
    return next && next !== at ? open(next) : null
  })
}

function undo() {
  queue(async () => {
    const answer = await send('undo', { run: LETTER, reviewer: by('reviewer').value })
    const undone = all.candidates.find(each => each.key === answer.undone)
    update(answer)
    await (undone && undone !== at ? open(undone) : again())
  })
}

async function write() {
  const out = by('out').value
  try {
    for (let state = await send('write', { run: LETTER, out }); ; state = await ask('written', { run: LETTER })) {
      if (state.error) return by('tool').textContent = state.error
      if (state.text) return by('tool').textContent = state.text
      by('tool').textContent = `Writing the map: ${state.phase} ${state.total ? `${state.done} of ${state.total}` : ''}`
      await new Promise(resolve => setTimeout(resolve, 200))
    }
  } catch (error) {
    say(error.message)
  }
}

const ACTIONS = {
  k: () => decide('static'), r: () => decide('dynamic'), x: () => decide('undecided'), u: undo, w: write,
  s: () => queue(() => {
    looked.add(at.number)
    update({ decisions, ...balance })
    return open(following() ?? at)
  }),
  n: () => step(1), j: () => step(1), p: () => step(-1),
  ArrowLeft: () => seek(frame - 1), ArrowRight: () => seek(frame + 1),
  f: () => { onwards = !onwards; tool() }, t: () => places.turn(), Escape: () => { places.clear(); tool() },
  '/': () => by('filters').elements.search.focus(),
  '?': () => by('help').open ? by('help').close() : by('help').showModal(),
}

addEventListener('keydown', event => {
  if (event.ctrlKey || event.metaKey || event.altKey || !place) return
  if (event.target.matches('input, select')) {
    if (event.key === 'Escape' || event.key === 'Enter') event.target.blur()
    return
  }
  if (!ACTIONS[event.key] || (by('help').open && event.key !== '?')) return
  event.preventDefault()
  ACTIONS[event.key]()
})
addEventListener('unhandledrejection', event => say(event.reason.message))
start()
