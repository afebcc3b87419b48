/** Heights of panels and widths of columns, in pixels, that the user gave them in each layout. Without elements. */

import { type LayoutName, parsed } from "./layouts";

export class Sizes {
  private readonly kept: Partial<Record<LayoutName, Record<string, number>>>;

  /** `kept` is the value that `save` last received. */
  constructor(
    kept: string,
    private readonly save: (kept: string) => void,
  ) {
    this.kept = parsed(kept) as typeof this.kept;
  }

  /** By the name of the panel or column; null: the layout decides. */
  of(layout: LayoutName, name: string): number | null {
    const size = this.kept[layout]?.[name];
    return typeof size === "number" && size > 0 ? size : null;
  }

  set(layout: LayoutName, name: string, size: number | null): void {
    const { [name]: _, ...others } = this.kept[layout] ?? {};
    this.kept[layout] = size === null ? others : { ...others, [name]: Math.round(size) };
    this.save(JSON.stringify(this.kept));
  }

  reset(layout: LayoutName): void {
    delete this.kept[layout];
    this.save(JSON.stringify(this.kept));
  }
}
