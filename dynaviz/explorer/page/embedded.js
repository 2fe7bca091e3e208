// Where the answers of a page that was sent come from: they are part of it. It takes the place of server.js.

export const served = false

const text = id => document.getElementById(id).textContent
const pictures = JSON.parse(text('pictures')), stored = unpacked(text('answers'))

async function unpacked(packed) {
  const bytes = Uint8Array.from(atob(packed), letter => letter.charCodeAt(0))
  return new Response(new Blob([bytes]).stream().pipeThrough(new DecompressionStream('gzip'))).json()
}

/** Name and query of a question, as its stored answer is named. */
const question = (name, { settings, ...query }) => `${name}?${Object.keys(query).sort().map(key => `${key}=${query[key]}`).join('&')}`

export async function answered(name, query) {
  if (name === 'layout') return { pictures: picturesOf(query) }
  const answer = (await stored)[question(name, query)]
  if (name === 'loading' || name === 'marks') return null
  if (name === 'dial' || name === 'judge') return turned(answer, JSON.parse(query.settings))
  if (answer === undefined) throw new Error('This page was sent without an answer to that. Run dynaviz explore.')
  return answer
}

/** Of the stored values of one parameter, the answer for the nearest; the page turns one at a time. */
function turned({ given, values }, settings) {
  const [name] = Object.keys(settings)
  if (name === undefined) return given
  const near = ([value]) => Math.abs(value - settings[name])
  return values[name].reduce((best, each) => near(each) < near(best) ? each : best)[1]
}

/** The pictures of a case, by frame: [frame, data of a WebP picture]. */
const picturesOf = ({ run, owner = run, case: number }) => (pictures[`${run} ${owner} ${number}`] ?? []).map(([frame, data]) => [frame, `data:image/webp;base64,${data}`])

/** The largest picture of a case, of its worst frame. */
export const drawing = query => picturesOf(query).reduce((best, [, data]) => data.length > best.length ? data : best, 'data:,')

export const recording = () => null
