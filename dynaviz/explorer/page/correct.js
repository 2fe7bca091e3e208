// Corrections of the ground truth, which are kept next to the run, and the scores with them.
import { ask, make, send } from './dom.js'
import { button } from './share.js'

/** The button that corrects the truth of a case, or withdraws that. */
export function correction(card, run, { changed, scored }) {
  if (!run.truth) return null
  const made = run.corrections[card.number], truth = made ?? (card.kind === 'ghost' ? 'static' : 'dynamic')
  const click = async () => {
    run.corrections = await send('correct', { run: card.of, case: card.number, ...(!made && { truth }) })
    changed()
    await rescored(card.of, run, scored)
  }
  return make('p', { class: 'correction' }, made ? `Corrected: these points are ${truth}. ` : 'Ground truth is wrong? ', button(made ? 'Undo' : `It is ${truth}`, click))
}

/** Score a run with its corrections. */
export async function rescored(letter, run, scored) {
  const asked = run.corrections, several = Object.keys(asked).length > 0
  run.rescored = several ? 'Scoring the run again …' : ''
  scored()
  if (!several) return
  const text = await ask('rescored', { run: letter }).then(answer => answer.text, error => error.message)
  if (asked !== run.corrections) return // changed meanwhile
  run.rescored = text
  scored()
}
