// Orders to a live robot: pause, home, and a goal by a click. Only a page with the token in its address gives any.

const AIMING = 'Click the place in the picture of the belief. Escape cancels.';
const CLICK = 5; // pixels that the pointer may move in a click

class Orders {
  constructor(player, token) {
    this.player = player;
    this.token = token;
    this.isAiming = this.isPaused = false;
    this.shown = '';
    const canvas = byId('belief'), on = (id, action) => byId(id).addEventListener('click', action);
    on('order-pause', () => this.send({order: this.isPaused ? 'go on' : 'pause'}));
    on('order-home', () => this.send({order: 'home'}));
    on('order-goal', () => this.aim(!this.isAiming));
    document.addEventListener('keydown', (press) => { if (press.key === 'Escape') this.aim(false); });
    canvas.addEventListener('pointerdown', (event) => { this.from = [event.offsetX, event.offsetY]; });
    canvas.addEventListener('click', (event) => {
      const moved = this.from ? Math.hypot(event.offsetX - this.from[0], event.offsetY - this.from[1]) : 0;
      if (this.isAiming && moved < CLICK) this.choose(...player.scene.toWorld(canvas, event.offsetX, event.offsetY));
    });
    byId('orders').hidden = false;
  }

  // The goal belongs to the newest map, so that is what the pictures show.
  aim(isWanted) {
    if (isWanted === this.isAiming) return;
    this.isAiming = isWanted;
    byId('order-goal').setAttribute('aria-pressed', String(isWanted));
    byId('belief').classList.toggle('aiming', isWanted);
    if (isWanted) {
      this.player.stopAt(this.player.recording.frames - 1);
      byId('belief').scrollIntoView({block: 'center'});
    }
    this.say(isWanted ? AIMING : this.shown);
  }

  choose(x, y) {
    this.aim(false);
    this.send({order: 'goal', x, y, map: this.player.recording.meta.map});
  }

  async send(order) {
    try {
      const answer = await fetch('/order', {method: 'POST', headers: {'X-Token': this.token}, body: JSON.stringify(order)});
      if (!answer.ok) this.say('This page gives no orders: open it by the address in the terminal.');
    } catch { this.say('The session is over, or the connection is lost.'); }
  }

  // What the robot has answered, and whether it is paused.
  show({paused, answer}) {
    this.isPaused = paused;
    byId('order-pause').textContent = paused ? 'Go on' : 'Pause';
    if (answer === this.shown) return;
    this.shown = answer;
    if (!this.isAiming) this.say(answer);
  }

  end() {
    this.aim(false);
    for (const button of byId('orders').querySelectorAll('button')) button.disabled = true;
    this.say('The session is over.');
  }

  say(words) { byId('order-answer').textContent = words; }
}
