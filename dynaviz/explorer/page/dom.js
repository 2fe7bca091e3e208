// Small helpers to build the page.
import { answered } from './server.js'

/** An element: `make('a', {href: '#', class: 'b'}, 'text', child)`. Functions become listeners; false and null are left out. */
export function make(name, attributes = {}, ...children) {
  const svg = ['svg', 'g', 'path', 'rect', 'line', 'circle', 'text', 'title', 'polyline', 'defs', 'pattern'].includes(name)
  const element = svg ? document.createElementNS('http://www.w3.org/2000/svg', name) : document.createElement(name)
  for (const [key, value] of Object.entries(attributes)) {
    if (value === false || value === null || value === undefined) continue
    if (typeof value === 'function') element.addEventListener(key, value)
    else element.setAttribute(key, value === true ? '' : value)
  }
  element.append(...children.flat().filter(child => child !== null && child !== undefined && child !== false))
  return element
}

let busy = 0
/** Mark the page as busy until the returned function is called. */
export function working() {
  document.body.toggleAttribute('data-busy', ++busy > 0)
  let done = () => document.body.toggleAttribute('data-busy', --busy > 0)
  return () => { done(); done = () => {} }
}

/** Ask a question; errors carry its message. While an answer is awaited, the page is marked as busy. */
export async function ask(name, query = {}, method = 'GET') {
  const done = working()
  try {
    return await answered(name, query, method)
  } finally {
    done()
  }
}

/** Have the server write something. */
export const send = (name, query) => ask(name, query, 'POST')

let hiding
/** Show a message for a few seconds. */
export function say(text) {
  const message = document.getElementById('message')
  message.textContent = text
  message.hidden = false
  clearTimeout(hiding)
  hiding = setTimeout(() => { message.hidden = true }, 6000)
}

export const words = name => name.replaceAll('_', ' ')
export const whole = number => Math.round(number).toLocaleString('en')
