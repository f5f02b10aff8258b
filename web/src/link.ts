// The socket: it opens again by itself, later and later, and says so.

import type { Frame, Message } from "./protocol";
import { decode, parse } from "./protocol";

const SHORTEST = 500; // ms
const LONGEST = 8000;
const SILENCE = 5000; // ms without a word, after which the socket is given up

export interface Listener {
  opened(): void;
  message(message: Message): void;
  frame(frame: Frame): void;
  waiting(seconds: number): void;
}

export class Link {
  private wait = SHORTEST;
  private heard = performance.now();
  private deadline = 0; // ms, when a socket without a word is given up
  private socket: WebSocket | null = null;

  constructor(private readonly listener: Listener) {
    this.open();
    setInterval(() => this.watch(), 1000);
    addEventListener("online", () => this.socket ?? this.open());
  }

  /** For how long [s] nothing has been heard of the server. */
  get quiet(): number {
    return (performance.now() - this.heard) / 1000;
  }

  private open(): void {
    const url = new URL("api/stream", location.href);
    url.protocol = url.protocol === "https:" ? "wss:" : "ws:";
    url.search = "";
    const socket = new WebSocket(url);
    socket.binaryType = "arraybuffer";
    this.socket = socket;
    this.deadline = performance.now() + SILENCE;
    socket.onopen = () => {
      this.wait = SHORTEST;
      this.heard = performance.now();
      this.listener.opened();
    };
    socket.onmessage = (event: MessageEvent<string | ArrayBuffer>) => {
      if (socket !== this.socket) return;
      this.heard = performance.now();
      this.deadline = this.heard + SILENCE;
      if (typeof event.data === "string") {
        this.listener.message(parse(event.data));
      } else {
        const frame = decode(event.data);
        if (frame) this.listener.frame(frame);
      }
    };
    socket.onclose = () => {
      if (socket === this.socket) this.again();
    };
  }

  private again(): void {
    this.socket = null;
    const wait = this.wait * (0.8 + 0.4 * Math.random());
    this.wait = Math.min(2 * this.wait, LONGEST);
    this.listener.waiting(wait / 1000);
    setTimeout(() => this.socket ?? this.open(), wait);
  }

  private watch(): void {
    const socket = this.socket;
    if (socket && performance.now() > this.deadline) {
      socket.onclose = null;
      socket.close();
      this.again();
    }
  }
}
