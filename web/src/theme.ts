// Dark and light: as the system says, until somebody chooses. Colours are Okabe and Ito's, told apart by anyone.

export interface Palette { ink: string; quiet: string; grid: string; lines: string[]; band: string; reference: string; event: string; paper: string }

const LIGHT: Palette = {
  ink: "#111a22", quiet: "#46535f", grid: "#d5dde4", paper: "#ffffff",
  lines: ["#0072b2", "#d55e00", "#00785a", "#a8487c", "#5d5200", "#111a22", "#2b7fb8", "#8a3d00"],
  band: "#0072b233", reference: "#d55e00", event: "#a8487c",
};
const DARK: Palette = {
  ink: "#f2f6f9", quiet: "#b4c1cc", grid: "#2c3a46", paper: "#111a22",
  lines: ["#56b4e9", "#e69f00", "#2fc79b", "#e59ac2", "#f0e442", "#f2f6f9", "#8fd0f5", "#ffb95e"],
  band: "#56b4e940", reference: "#e69f00", event: "#e59ac2",
};
export const DASHES: number[][] = [[], [7, 4], [2, 3], [10, 3, 2, 3], [4, 2], [1, 2], [12, 4], [6, 2, 1, 2]];

const KEY = "towtank-theme";
const system = matchMedia("(prefers-color-scheme: dark)");
const listeners: (() => void)[] = [];

const chosen = (): string | null => localStorage.getItem(KEY);
export const dark = (): boolean => (chosen() ? chosen() === "dark" : system.matches);
export const palette = (): Palette => (dark() ? DARK : LIGHT);
export const onTheme = (listener: () => void): void => void listeners.push(listener);

function apply(): void {
  document.documentElement.dataset.theme = dark() ? "dark" : "light";
  for (const listener of listeners) listener();
}

export function switchTheme(): void {
  localStorage.setItem(KEY, dark() ? "light" : "dark");
  apply();
}

system.addEventListener("change", apply);
apply();
