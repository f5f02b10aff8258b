// Buttons and keys.

import { byId, write } from "./dom";
import type { Hello, State } from "./protocol";
import { dark, onTheme, switchTheme } from "./theme";

const KEYS = "towtank-keys";

export class Controls {
  private readonly pause = byId<HTMLButtonElement>("pause");
  private readonly mark = byId<HTMLInputElement>("mark-text");
  private paused = false;
  private steers = false;
  private linked = false;

  constructor() {
    this.pause.onclick = () => void this.post(this.paused ? "resume" : "pause");
    byId<HTMLFormElement>("mark").onsubmit = (event) => {
      event.preventDefault();
      void this.post("mark", { text: this.mark.value }).then((done) => {
        if (done) this.mark.value = "";
      });
    };
    byId("theme").onclick = switchTheme;
    byId("help").onclick = () => byId<HTMLDialogElement>("help-dialog").showModal();
    onTheme(() => this.names());
    this.names();
    const keys = byId<HTMLInputElement>("keys");
    keys.checked = localStorage.getItem(KEYS) !== "off";
    keys.onchange = () => localStorage.setItem(KEYS, keys.checked ? "on" : "off");
    addEventListener("keydown", (event) => this.key(event, keys.checked));
  }

  greet(hello: Hello): void {
    byId("report").hidden = !hello.report;
  }

  show(state: State): void {
    this.paused = state.paused;
    byId("recording").hidden = state.recording === null;
    write(this.pause, this.paused ? "Go on learning" : "Pause learning");
    this.enable();
  }

  link(linked: boolean): void {
    this.linked = linked;
    this.enable();
  }

  you(steers: boolean): void {
    this.steers = steers;
    this.enable();
  }

  /** Whether this viewer may steer, and is heard. */
  get able(): boolean {
    return this.steers && this.linked;
  }

  private enable(): void {
    const able = this.able;
    const why = this.steers ? "" : "Open the address that was printed at the start to pause and mark.";
    for (const element of [this.pause, this.mark, byId<HTMLFormElement>("mark").querySelector("button")!]) {
      if (element.disabled === able) element.disabled = !able;
      element.title = why;
    }
    const model = byId<HTMLAnchorElement>("model");
    model.toggleAttribute("aria-disabled", !this.linked);
  }

  private names(): void {
    write(byId("theme"), dark() ? "Light" : "Dark");
    byId("theme").setAttribute("aria-label", dark() ? "Light colours" : "Dark colours");
  }

  async post(what: string, body?: object): Promise<boolean> {
    try {
      const headers = { "content-type": "application/json" };
      const answer = await fetch(`api/${what}`, { method: "POST", headers, body: body && JSON.stringify(body) });
      return answer.ok;
    } catch {
      return false;
    }
  }

  private key(event: KeyboardEvent, wanted: boolean): void {
    const target = event.target as HTMLElement;
    if (!wanted || event.ctrlKey || event.metaKey || event.altKey || target.closest("input, dialog")) return;
    if (event.key === "p" && !this.pause.disabled) this.pause.click();
    else if (event.key === "m" && !this.mark.disabled) this.mark.focus();
    else if (event.key === "s") byId("model").click();
    else if (event.key === "b" && !byId<HTMLButtonElement>("plan-begin").disabled) byId("plan-begin").click();
    else if (event.key === "h" && !byId<HTMLButtonElement>("plan-hold").disabled) byId("plan-hold").click();
    else if (event.key === "t") switchTheme();
    else if (event.key === "?") byId("help").click();
    else return;
    event.preventDefault();
  }
}
