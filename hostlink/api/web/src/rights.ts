/** What the daemon allows this page: its token's role. */

import { notice } from "./notice";

const SHOWN_MS = 5000;

export class Rights {
  /** Whether it may drive, unlock and change; an older daemon does not say, and then refuses. */
  canDrive = true;

  constructor(private readonly onChange: () => void) {}

  setRole(role: string | null): void {
    const canDrive = role !== "read";
    if (canDrive === this.canDrive) return;
    this.canDrive = canDrive;
    if (!canDrive) notice("done", "This token may only read: you may watch, and stop robots.", SHOWN_MS);
    this.onChange();
  }
}
