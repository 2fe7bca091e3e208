// The keyboard.
import { make } from './dom.js'
import { served } from './server.js'

const KEYS = {
  j: 'next case', k: 'previous case', space: 'play or pause', f: 'the frame', m: 'the map', c: 'the case again', '/': 'search', r: 'review the map', '?': 'these keys', Escape: 'close',
}

const ALWAYS = ['?', 'Escape']

/** Call the actions of keys, unless the user is typing. */
export function listen(actions) {
  const help = document.getElementById('help')
  const keys = Object.entries(KEYS).filter(([key]) => actions[key] || ALWAYS.includes(key))
  help.append(make('h2', {}, 'Keys'), make('dl', {}, keys.flatMap(([key, text]) => [make('dt', {}, make('kbd', {}, key)), make('dd', {}, text)])),
    make('p', {}, served ? 'Drag to turn, scroll to zoom, click a point to see why it got its label.' : 'Click a card, a picture, or a large point of a case.'), make('form', { method: 'dialog' }, make('button', {}, 'Close')))
  // On the window before the viewer, which would take the keys for itself after a click into it.
  addEventListener('keydown', event => {
    const typing = event.target.matches('input:not([type=button]), textarea, select') && event.target.closest('#filters')
    if (event.ctrlKey || event.metaKey || event.altKey) return
    if (typing) {
      if (event.key === 'Escape') event.target.blur()
      return
    }
    const key = event.key === ' ' ? 'space' : event.key
    const action = key === '?' ? () => help.open ? help.close() : help.showModal() : help.open ? null : actions[key]
    if (!action || (key === 'space' && event.target.matches('button, summary'))) return
    event.preventDefault()
    event.stopImmediatePropagation()
    action()
  }, true)
}
