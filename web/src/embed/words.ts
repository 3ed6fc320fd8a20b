/** The few words of the component, in the language of the element it stands in. */
export interface Words {
  play: string;
  pause: string;
  gate: string;
  canvas: string;
  loading: string;
  failed: string;
  ef: string;
}

const WORDS: Record<string, Words> = {
  en: { play: "Play", pause: "Pause", gate: "Gate", canvas: "Model of the left ventricle; arrow keys turn it", loading: "Loading…", failed: "The model could not be loaded", ef: "EF" },
  de: { play: "Abspielen", pause: "Anhalten", gate: "Gate", canvas: "Modell des linken Ventrikels; Pfeiltasten drehen es", loading: "Wird geladen …", failed: "Das Modell konnte nicht geladen werden", ef: "EF" },
  es: { play: "Reproducir", pause: "Pausar", gate: "Fase", canvas: "Modelo del ventrículo izquierdo; las flechas lo giran", loading: "Cargando…", failed: "No se pudo cargar el modelo", ef: "FE" },
};

const ENGLISH = WORDS["en"] as Words;

/** The words for an element, by its own language, that of what it stands in, or the browser's. */
export function wordsFor(element: Element): Words {
  const tag = element.closest("[lang]")?.getAttribute("lang") ?? navigator.language;
  return WORDS[tag.split("-")[0] ?? ""] ?? ENGLISH;
}
