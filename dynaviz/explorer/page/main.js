// The explorer: cards, viewers and the panel of the chosen point, held together by the state in the address.
import { allCards, cardElement, chosen, differs, filters, worth } from './cards.js'
import { ask, make, say, send, working } from './dom.js'
import { correction, rescored } from './correct.js'
import { showDial } from './dial.js'
import { listen } from './keys.js'
import { drawing, recording, served } from './server.js'
import { button, buttons, copy } from './share.js'
import { change, current, read } from './state.js'
import { Viewer } from './viewer.js'
import { PointPanel, showCase } from './why.js'

const by = id => document.getElementById(id)
const WRONG = ['false_positive', 'false_negative', 'unlabelled_removed']
const LEGEND = [['ghost kept', 'dynamic, kept'], ['hole removed', 'static, removed'], ['ghost removed', 'dynamic, removed'], ['static', 'static, kept']]
const LEGEND_UNLABELLED = [['cluster', 'removed'], ['static', 'kept']]
const LEGEND_CHANGES = [['cluster', 'appeared or disappeared'], ['static', 'seen again, or not seen']]
const VIEWERS = 2 // of the first runs; the others are asked about the same points
const viewers = {}
let runs, cards, panel, turned = null, list = []

async function start() {
  const state = read()
  runs = await ask('runs')
  cards = allCards(runs)
  headings()
  filters(by('filters'), cards, runs, state, () => {
    change(Object.fromEntries(new FormData(by('filters'))))
    showList()
  })
  panel = new PointPanel(by('point'), runs, letter => mark(letter), letter => scansOf(letter, pointShown))
  showList()
  for (const letter of Object.keys(runs)) rescored(letter, runs[letter], headings)
  if (!runs.b) showDial(by('dial'), 'a', { turned: turn, start: settings => startRun('a', settings) }).catch(error => say(error.message))
  const first = find(state.of, state.case) ?? list[0]
  if (first) change({ of: first.of, case: first.number })
  showCard()
  const frame = Math.min(state.frame ?? first?.worst ?? 0, runs.a.frames - 1)
  change({ frame })
  showCursor(frame)
  for (const letter of Object.keys(runs).slice(0, VIEWERS)) openViewer(letter, frame)
  const asked = state.point !== undefined ? [state.at ?? state.frame ?? 0, state.point] : first?.point != null && frame === first.worst ? [first.worst, first.point] : null
  if (asked) await explain(ask('point', { frame: asked[0], point: asked[1] }), state.point !== undefined)
  window.explorer = { viewers, current, clicked, cards: () => cards } // for tests, and for the console
  document.body.dataset.ready ??= 'page'
}

function headings() {
  const { a, b } = runs, each = show => Object.entries(runs).map(([letter, run]) => `${b ? `${letter.toUpperCase()} ` : ''}${show(run)}`)
  document.title = `${Object.values(runs).map(run => run.title).join(', ')} on ${a.sequence}`
  by('run').textContent = `${each(run => run.title).join(', ')}: ${a.sequence}`
  const scores = run => Object.entries(run.scores).filter(([, value]) => value !== null).map(([name, value]) => `${name} ${value.toFixed(2)}`).join('  ')
  by('scores').textContent = a.compares ? 'What changed between two drives.' : !a.truth ? 'No ground truth: judge the removed points yourself.' : each(scores).join('\n') + (b ? '' : ` %${a.possible ? `\nThe drive allows DA ${a.possible} %` : ''}`)
  by('legend').replaceChildren(...(a.truth ? LEGEND : a.compares ? LEGEND_CHANGES : LEGEND_UNLABELLED).map(([kind, words]) => make('span', { class: `key ${kind}` }, words)))
  by('corrected').textContent = Object.entries(runs).filter(([, run]) => run.rescored).map(([letter, run]) => `${b ? `${letter.toUpperCase()}: ` : ''}${run.rescored}`).join('\n')
}

const find = (of, number) => cards.find(card => card.of === of && card.number === number)
const selected = () => find(current().of, current().case)

function showList() {
  list = chosen(cards, current(), turned)
  const most = Math.max(...cards.map(worth))
  const unit = cards.some(card => card.cost !== null) ? 'cases' : cards.some(differs) ? 'changes' : 'clusters of removed points'
  by('count').textContent = `${list.length === cards.length ? '' : `${list.length} of `}${cards.length} ${unit}`
  by('cards').replaceChildren(...list.map(card => cardElement(card, runs, most, open, runs[card.of].corrections[card.number], turned?.[card.number])))
  highlight()
}

function highlight() {
  for (const element of document.querySelectorAll('.card[aria-current]')) element.removeAttribute('aria-current')
  const element = by(`card-${current().of}-${current().case}`)
  element?.setAttribute('aria-current', 'true')
  element?.scrollIntoView({ block: 'nearest' })
}

function showCard() {
  const card = selected()
  highlight()
  showCase(by('case'), card, runs, card && buttons(card, runs[card.of]), card && served && correction(card, runs[card.of], { changed: corrected, scored: headings }),
    (letter, points) => scansOf(letter, () => ({ case: card.number, ...(points && { points }) })), goTo,
    row => explain(ask('point', { frame: card.worst, point: row }), true))
}

/** With other parameters, each card states what it would cost. */
function turn(costs) {
  turned = costs
  showList()
}

/** After a correction, the card and the point state the corrected truth. */
function corrected() {
  showList()
  showCard()
  if (panel.shown) explain(ask('point', { frame: panel.shown.frame, point: panel.shown.point }), false)
}

const pointShown = () => panel.shown && { frame: panel.shown.frame, point: panel.shown.point }

/** What the strips of scans of a run do: light up the rays of a scan, go to it, and start a run with other parameters. */
const scansOf = (letter, what) => ({
  hover: frame => frame === null ? mark(letter) : light(letter, { ...what(), lit: frame }),
  pick: ({ frame, sensor: [x, y, z] }) => {
    change({ layout: 'case' })
    goTo(frame)
    layOut({ x, y, z })
  },
  start: settings => startRun(letter, settings),
})

function goTo(frame) {
  change({ frame })
  showCursor(frame)
  for (const viewer of Object.values(viewers)) viewer.seek(frame)
}

/** The cursor in strips over time. */
const showCursor = frame => document.body.style.setProperty('--frame', frame)

let lighting = Promise.resolve(), next = null
/** Draw the rays of a point or a case, those of one frame bright; of several requests that wait, the last one counts. */
function light(letter, query) {
  next = { letter, query }
  lighting = lighting.then(async () => {
    if (!next) return
    const { letter, query } = next
    next = null
    viewers[letter]?.show(await ask('marks', { run: letter, ...query }))
  }).catch(error => say(error.message))
}

/** Repeat a run with other parameters, then open the comparison. */
async function startRun(letter, settings) {
  const query = { run: letter, settings: JSON.stringify(Object.fromEntries(settings)) }
  for (let answer = await send('run', query); ; answer = await ask('run', query)) {
    if (answer.error) return say(answer.error)
    if (answer.url) return location.assign(answer.url)
    say(`Running ${settings.map(([name, value]) => `${name}=${value}`).join(', ')}: ${answer.phase} ${answer.total ? `${answer.done} of ${answer.total}` : ''}`)
    await new Promise(resolve => setTimeout(resolve, 700))
  }
}

/** Go to a case: its worst frame, an eye that frames it, and a wrong point in the middle of it. */
async function open(card) {
  change({ of: card.of, case: card.number, layout: 'case', at: undefined, point: undefined })
  showCard()
  goTo(card.worst)
  for (const preview of document.querySelectorAll('.preview')) preview.src = pictureFor(preview.dataset.run, preview)
  await Promise.all([layOut(), card.point == null ? panel.hint() : explain(ask('point', { frame: card.worst, point: card.point }), false)])
}

function step(by) {
  const at = list.findIndex(card => card === selected())
  const next = list[Math.min(Math.max(at + by, 0), list.length - 1)]
  if (next && next !== selected()) open(next)
}

function layout(kind) {
  change({ layout: kind })
  layOut()
}

/** What the server needs for the layout of the state; eye: where a case is seen from, if not from its usual place. */
function layoutQuery(letter, eye) {
  const { of, case: number, layout: kind } = current()
  return { run: letter, owner: of, layout: kind, ...eye, ...(number && { case: number }) }
}

let layouts = 0
/** Lay out the viewers; of several requests on their way, the last one counts. */
async function layOut(eye) {
  const mine = ++layouts, { case: number, layout: kind } = current()
  await Promise.all(Object.keys(viewers).map(letter => arrange(letter, eye))).catch(error => say(error.message))
  if (mine === layouts) document.body.dataset.layout = `${kind}-${number}`
}

/** Lay out one viewer, unless another layout was asked for meanwhile. */
async function arrange(letter, eye) {
  const mine = layouts, answer = await ask('layout', layoutQuery(letter, eye))
  if (mine === layouts) viewers[letter].show(answer)
}

/** The mark and the rays of the explained point. */
const mark = letter => light(letter, pointShown())

function openViewer(letter, frame) {
  const place = make('div', { class: 'viewer' }), section = make('section', { 'data-run': letter }, runs.b && make('h2', {}, `${letter.toUpperCase()} ${runs[letter].title}`), place)
  by('viewers').append(section)
  const loaded = working(), seen = awaitClicks(place)
  if (selected()) {
    const preview = make('img', { class: 'preview', alt: 'the case, while the viewer is loading', 'data-run': letter })
    place.append(preview)
    requestAnimationFrame(() => { preview.src = pictureFor(letter, place) }) // when all viewers have their size
  }
  viewers[letter] = new Viewer(place, [ask('loading', { run: letter }), recording(letter), ask('layout', { ...layoutQuery(letter), first: 1 })], frame, {
    drawn: async () => {
      section.querySelector('.preview')?.remove()
      if (current().layout === 'case') await arrange(letter)
      loaded()
      if (Object.values(viewers).every(viewer => viewer.drawn)) document.body.dataset.ready = 'viewer'
    },
    click: item => {
      seen()
      clicked(letter, item)
    },
    time: frame => moved(letter, frame),
    played: playing => {
      if (!playing) for (const viewer of others(letter)) viewer.follow(viewers[letter].time)
    },
  })
}

/** A picture of the case for a place of the page. */
function pictureFor(letter, { clientWidth: width, clientHeight: height }) {
  const { of, case: number } = current()
  return drawing({ run: letter, owner: of, case: number, width, height })
}

/** Mark the page as busy from a click until the viewer reports it; on a busy machine it draws first. */
function awaitClicks(place) {
  let down = null, seen = () => {}
  place.addEventListener('pointerdown', event => { down = event }, true)
  place.addEventListener('pointerup', event => {
    if (!down || Math.hypot(event.clientX - down.clientX, event.clientY - down.clientY) > 4) return
    seen()
    seen = working()
    setTimeout(seen, 4000) // a click on nothing is not reported
  }, true)
  return () => seen()
}

const others = letter => Object.entries(viewers).filter(([other]) => other !== letter).map(([, viewer]) => viewer)

/** One cursor: the other viewer follows. */
function moved(letter, frame) {
  for (const viewer of others(letter)) if (viewer.time !== frame) viewer.follow(frame)
  change({ frame })
  showCursor(frame)
}

async function clicked(letter, { entity_path, instance_id, position: [x, y, z] }) {
  const place = { run: letter, entity: entity_path, frame: viewers[letter].time, x, y, z }
  await explain(ask('click', { ...place, ...(instance_id !== undefined && instance_id !== null && { instance: instance_id }) }), true)
}

async function explain(answer, asked) {
  try {
    const found = await answer
    if (asked) change({ at: found.frame, point: found.point })
    if (asked && panel.open && Object.values(found.runs).every(({ outcome }) => !WRONG.includes(outcome))) {
      panel.mention(found, () => explain(found, false))
      return
    }
    const ready = panel.show(found, asked)
    by('point').append(make('p', { class: 'buttons' }, Object.entries(found.commands).map(([letter, command]) => button(runs.b ? `Command ${letter.toUpperCase()}` : 'Command', () => copy(command)))))
    Object.keys(viewers).forEach(mark)
    await ready
  } catch (error) {
    if (panel.open) say(error.message)
    else panel.hint(error.message)
  }
}

const VIEWER_KEYS = {
  f: () => layout('frame'), m: () => layout('map'), c: () => layout('case'), space: () => Object.values(viewers)[0]?.play(!Object.values(viewers)[0].playing),
  r: () => by('review').click(),
}
by('review').parentElement.hidden = !served
listen({ j: () => step(1), k: () => step(-1), '/': () => by('filters').elements.search.focus(), ...(served && VIEWER_KEYS) })
addEventListener('unhandledrejection', event => say(event.reason.message))
start()
