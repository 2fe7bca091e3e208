// What other parameters would change at some points: the server judges their stored evidence again.
import { ask, make, whole } from './dom.js'
import { latest, sliderRows } from './dial.js'
import { served } from './server.js'

/**
 * Sliders for the parameters that enter.
 * @param whatIf as the server's what_if; query: which points; card: whose cost changes with the points, or null; start: called with the settings
 */
export function sliders(whatIf, query, card, start) {
  const { removed: before, points: all } = whatIf
  let settings = {}
  const result = make('p', { class: 'result', role: 'status' }), go = make('button', { type: 'button', hidden: true, click: () => start(Object.entries(settings)) }, 'Run with this')
  const say = removed => {
    const wrong = count => card.kind === 'ghost' ? all - count : count
    const counts = all === 1 ? `This point would be ${removed ? 'removed' : 'kept'}.` : `${whole(removed)} of ${whole(all)} points would be removed; ${whole(before)} are.`
    const cost = !card || card.cost === null || all === 1 || !wrong(before) ? '' : ` The case would cost ${(card.cost * wrong(removed) / wrong(before)).toFixed(2)} % of ${card.metric} instead of ${card.cost.toFixed(2)} %.`
    return `${counts}${cost} What else would change is unknown until a run.`
  }
  const rows = sliderRows(whatIf.parameters, latest(async values => {
    settings = values
    const same = !Object.keys(values).length
    go.hidden = same || !served
    result.textContent = same ? '' : say((await ask('judge', { ...query, settings: JSON.stringify(values) })).removed)
  }))
  return make('details', { class: 'sliders' }, make('summary', {}, 'What would flip it'), rows, result, go)
}
