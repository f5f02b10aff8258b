// The drive: its switch, and a key that must be held. Signs of the key are sent while it is down; letting go is sent at
// once, and where the page is left, hidden, or no longer heard, the signs end, which stops thrust as well.

import { byId, write } from "./dom";
import type { Drive as Standing } from "./protocol";

const EVERY = 60; // ms between two signs of the key
const IN_FLIGHT = 2; // signs that are on their way at most: what a link holds up must not come late in a row

/** Whether keys are letters there. */
const types = (target: EventTarget | null): boolean => target instanceof HTMLElement && target.closest("input, dialog") !== null;

export class Drive {
  private readonly place = document.createElement("div");
  private readonly text = document.createElement("p");
  private readonly onOff = document.createElement("button");
  private readonly key = document.createElement("button");
  private standing: Standing | null = null;
  private able = false;
  private timer = 0;
  private flying = 0;

  constructor(private readonly post: (what: string) => Promise<boolean>) {
    this.place.id = "drive";
    this.place.hidden = true;
    this.text.setAttribute("role", "status");
    this.onOff.id = "drive-switch";
    this.key.id = "drive-key";
    this.onOff.type = this.key.type = "button";
    this.key.setAttribute("aria-keyshortcuts", "Space");
    write(this.key, "Hold to drive");
    const buttons = document.createElement("div");
    buttons.className = "buttons";
    buttons.setAttribute("role", "group");
    buttons.setAttribute("aria-label", "The drive");
    buttons.append(this.onOff, this.key);
    this.place.append(this.text, buttons);
    byId("plan").querySelector(".drive")!.after(this.place);
    this.onOff.onclick = () => void post(this.standing?.stage === "off" ? "drive-on" : "drive-off");
    this.key.onpointerdown = (event) => {
      this.key.setPointerCapture(event.pointerId);
      this.press();
    };
    for (const name of ["pointerup", "pointercancel", "lostpointercapture"]) this.key.addEventListener(name, () => this.release());
    this.key.oncontextmenu = (event) => event.preventDefault();
    addEventListener("keydown", (event) => this.space(event, true), true);
    addEventListener("keyup", (event) => this.space(event, false), true);
    addEventListener("focusin", (event) => types(event.target) && this.release());
    addEventListener("blur", () => this.release());
    addEventListener("pagehide", () => this.release());
    document.addEventListener("visibilitychange", () => this.release());
  }

  show(standing: Standing | null | undefined, able: boolean): void {
    this.standing = standing ?? null;
    this.able = able;
    this.place.hidden = this.standing === null;
    if (!able || !this.wanted) this.release(); // after a stop the key is pressed anew
    if (this.standing === null) return;
    const { stage, walls } = this.standing;
    this.place.dataset.stage = stage;
    write(this.text, walls && stage === "ready" ? `${this.standing.text} Walls: ${walls}.` : this.standing.text);
    write(this.onOff, stage === "off" ? "Switch the drive on" : "Switch the drive off");
    this.onOff.disabled = !able;
    this.key.disabled = !able || !this.wanted;
  }

  /** Whether the key does anything. */
  private get wanted(): boolean {
    return this.standing !== null && this.standing.stage !== "off";
  }

  private space(event: KeyboardEvent, down: boolean): void {
    if (event.code !== "Space" && event.key !== " ") return;
    if (!down) this.release(); // whatever has the focus by now
    if (types(event.target) || !this.wanted || !this.able) return;
    event.preventDefault(); // not a click on whatever has the focus
    event.stopPropagation();
    if (down && !event.repeat) this.press();
  }

  private press(): void {
    if (this.timer || !this.able || !this.wanted) return;
    this.place.dataset.held = "true";
    this.timer = window.setInterval(() => this.sign(), EVERY);
    this.sign();
  }

  private sign(): void {
    if (this.flying >= IN_FLIGHT) return;
    this.flying++;
    void this.post("drive-key").finally(() => this.flying--);
  }

  private release(): void {
    if (!this.timer) return;
    clearInterval(this.timer);
    this.timer = 0;
    delete this.place.dataset.held;
    void this.post("drive-let-go");
  }
}
