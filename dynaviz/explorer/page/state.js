// The state of the page, all of it in the address, so that a link restores it.

const NUMBERS = ['case', 'frame', 'at', 'point']
const TEXTS = ['of', 'layout', 'kind', 'cause', 'what', 'range', 'reason', 'object', 'by', 'sort', 'search']
const WAIT = 300 // ms between changes of the address; browsers limit them

const state = { of: 'a', layout: 'case', sort: 'cost' }
const defaults = { ...state }
let pending

/** of: run of the case; case; layout: case, frame or map; frame: of the cursor; at, point: the explained point; filters; sort. */
export function current() { return state }

export function read(text = location.search) {
  for (const name of [...NUMBERS, ...TEXTS]) delete state[name]
  Object.assign(state, defaults)
  for (const [name, value] of new URLSearchParams(text)) {
    if (TEXTS.includes(name)) state[name] = value
    else if (NUMBERS.includes(name) && /^\d+$/.test(value)) state[name] = Number(value)
  }
  return state
}

/** Change the state; values that are undefined or empty are removed. */
export function change(values) {
  Object.assign(state, values)
  for (const name of Object.keys(state)) if (state[name] === undefined || state[name] === '') delete state[name]
  pending ??= setTimeout(write, WAIT)
  return state
}

export function address() {
  const chosen = Object.entries(state).filter(([name, value]) => defaults[name] !== value)
  return location.pathname + (chosen.length ? `?${new URLSearchParams(chosen)}` : '')
}

function write() {
  pending = undefined
  history.replaceState(null, '', address())
}
