// Where the page's answers come from: the server of the explorer. A page that was sent has embedded.js in its place.

/** Whether a server answers: it can be asked about any point, and can write files. */
export const served = true

/** What the server answers: JSON, or the content of a file. */
export async function answered(name, query, method) {
  const answer = await fetch(`api/${name}?${new URLSearchParams(query)}`, { method })
  const plain = answer.headers.get('content-type')?.startsWith('application/json')
  const content = plain ? await answer.json() : await answer.arrayBuffer()
  if (!answer.ok) throw new Error(content.error ?? `The server answered ${answer.status}.`)
  return content
}

/** The address of a picture of a case that is drawn at once; run: whose points; owner: whose case; width, height: pixels. */
export const drawing = query => `api/drawing?${new URLSearchParams(query)}`

/** The recording of a run. */
export const recording = letter => fetch(`${letter}.rrd`).then(answer => answer.arrayBuffer())
