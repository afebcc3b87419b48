/** The panels of each layout and their columns: the defaults, and what the user moved. Without elements. */

export const LAYOUTS = ["Drive", "Tune", "Fleet", "Watch"] as const;
export type LayoutName = (typeof LAYOUTS)[number];

export const COLUMNS = ["left", "middle", "right"] as const;
export type Column = (typeof COLUMNS)[number];

/** Panels of each column, from the top; `away`: removed from this layout by the user. */
export type Arrangement = Record<Column | "away", string[]>;

/** A panel as the layouts know it. */
export interface Place {
  name: string;
  places: Partial<Record<LayoutName, Column>>; // default column in each layout
  wide?: Partial<Record<LayoutName, Column>>; // the same in a wide window, where it differs
}

export class Layouts {
  private readonly moved: Partial<Record<LayoutName, Arrangement>>;

  /** `kept` is the value that `save` last received. */
  constructor(
    private readonly panels: readonly Place[],
    private readonly isWide: () => boolean,
    kept: string,
    private readonly save: (kept: string) => void,
  ) {
    this.moved = parsed(kept) as typeof this.moved;
  }

  /** The layout as the user left it; panels that are new since then are in their default place. */
  arrangement(layout: LayoutName): Arrangement {
    const known = this.panels.map(({ name }) => name);
    const arrangement: Arrangement = { left: [], middle: [], right: [], away: [] };
    for (const column of [...COLUMNS, "away"] as const) {
      const names = this.moved[layout]?.[column];
      if (Array.isArray(names)) arrangement[column] = [...new Set(names)].filter((name) => known.includes(name));
    }
    const placed = new Set(Object.values(arrangement).flat());
    for (const { name, places, wide } of this.panels) {
      const column = (this.isWide() && wide?.[layout]) || places[layout];
      if (!placed.has(name)) arrangement[column ?? "away"].push(name);
    }
    return arrangement;
  }

  /** Move a panel to the end of a column, or out of the layout. */
  put(layout: LayoutName, name: string, column: Column | "away"): void {
    const arrangement = this.arrangement(layout);
    for (const names of Object.values(arrangement)) remove(names, name);
    arrangement[column].push(name);
    this.keep(layout, arrangement);
  }

  /** Move a panel up (-1) or down (1) in its column. */
  shift(layout: LayoutName, name: string, by: -1 | 1): void {
    const arrangement = this.arrangement(layout);
    for (const names of Object.values(arrangement)) {
      const at = names.indexOf(name);
      const other = names[at + by];
      if (at >= 0 && other !== undefined) [names[at], names[at + by]] = [other, name];
    }
    this.keep(layout, arrangement);
  }

  columnOf(layout: LayoutName, name: string): Column | "away" {
    const arrangement = this.arrangement(layout);
    return COLUMNS.find((column) => arrangement[column].includes(name)) ?? "away";
  }

  /** Restore the default places. */
  reset(layout: LayoutName): void {
    delete this.moved[layout];
    this.save(JSON.stringify(this.moved));
  }

  private keep(layout: LayoutName, arrangement: Arrangement): void {
    this.moved[layout] = arrangement;
    this.save(JSON.stringify(this.moved));
  }
}

function remove(names: string[], name: string): void {
  const at = names.indexOf(name);
  if (at >= 0) names.splice(at, 1);
}

/** An object that was kept as text; an empty one if it is not readable. */
export function parsed(kept: string): object {
  try {
    const value: unknown = JSON.parse(kept);
    return typeof value === "object" && value !== null ? value : {};
  } catch {
    return {}; // from another version, or edited by hand
  }
}
