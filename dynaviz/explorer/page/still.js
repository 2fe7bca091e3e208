// Pictures of a case in the place of the viewer, in a page that was sent. It takes the place of viewer.js.
import { make } from './dom.js'

export class Viewer {
  /** As the viewer; the last of the contents is the answer about a layout, which has the pictures. */
  constructor(element, contents, frame, on) {
    this.on = on
    this.time = frame
    this.playing = false
    this.pictures = []
    this.large = make('img', { class: 'large', alt: '' })
    this.small = make('div', { class: 'frames' })
    element.append(make('div', { class: 'still' }, this.large, this.small))
    contents.at(-1).then(content => {
      this.show(content)
      this.drawn = true
      on.drawn()
    })
  }

  /** Show the picture of the frame that is nearest. */
  seek(frame) {
    this.time = frame
    const distance = ([of]) => Math.abs(of - frame)
    const shown = this.pictures.reduce((best, each) => distance(each) < distance(best) ? each : best, this.pictures[0])
    if (!shown) return
    this.large.src = shown[1]
    this.large.alt = `the case in frame ${shown[0]}`
    for (const button of this.small.children) button.ariaPressed = Number(button.dataset.frame) === shown[0]
  }

  follow(frame) { this.seek(frame) }

  play() {}

  show(content) {
    if (!content?.pictures) return
    this.pictures = content.pictures
    this.small.replaceChildren(...this.pictures.map(([frame, data]) => make('button', { type: 'button', 'data-frame': frame, click: () => {
      this.seek(frame)
      this.on.time(frame)
    } }, make('img', { src: data, alt: '' }), `frame ${frame}`)))
    this.seek(this.time)
  }
}
