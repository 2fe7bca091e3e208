// The keyboard.
import { make } from './dom.js'

const KEYS = {
  j: 'next case', k: 'previous case', space: 'play or pause', f: 'the frame', m: 'the map', c: 'the case again', '/': 'search', r: 'review the map', '?': 'these keys', Escape: 'close',
}

/** Call the actions of keys, unless the user is typing. */
export function listen(actions) {
  const help = document.getElementById('help')
  help.append(make('h2', {}, 'Keys'), make('dl', {}, Object.entries(KEYS).flatMap(([key, text]) => [make('dt', {}, make('kbd', {}, key)), make('dd', {}, text)])),
    make('p', {}, 'Drag to turn, scroll to zoom, click a point to see why it got its label.'), make('form', { method: 'dialog' }, make('button', {}, 'Close')))
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
