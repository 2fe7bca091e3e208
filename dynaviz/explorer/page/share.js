// Copy the state of the page: as a link, a command, a picture or a clip.
import { ask, make, say } from './dom.js'
import { served } from './server.js'
import { address } from './state.js'

/** The buttons of a case. */
export function buttons(card, run) {
  const query = { run: card.of, case: card.number }, name = `case-${card.number}`
  const command = `dynaviz view ${run.path} --case ${card.number} -o ${name}.png`
  if (!served) return [button('Command', () => copy(command))]
  return [
    button('Link', () => copy(location.origin + address())),
    button('Command', () => copy(command)),
    button('Picture', () => picture(query, `${name}.png`)),
    button('Clip', () => save('clip', query, `${name}.mp4`, 'video/mp4')),
  ]
}

export const button = (label, click) => make('button', { type: 'button', click: () => Promise.resolve(click()).catch(error => say(error.message)) }, label)

export async function copy(text) {
  await navigator.clipboard.writeText(text)
  say(`Copied: ${text}`)
}

async function picture(query, name) {
  say('Drawing the picture …')
  const blob = new Blob([await ask('picture', query)], { type: 'image/png' })
  try {
    await navigator.clipboard.write([new ClipboardItem({ 'image/png': blob })])
    say('The picture is in the clipboard.')
  } catch {
    download(blob, name) // the page lost the focus, or the browser forbids pictures
  }
}

async function save(kind, query, name, type) {
  say('Drawing the clip, up to a minute …')
  download(new Blob([await ask(kind, query)], { type }), name)
}

function download(blob, name) {
  const url = URL.createObjectURL(blob)
  make('a', { href: url, download: name }).click()
  setTimeout(() => URL.revokeObjectURL(url), 60000)
  say(`Saved as ${name}.`)
}
