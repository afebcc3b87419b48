/** The rights of this page: the role of its token. */

import { notice } from "./notice";

const SHOWN_MS = 5000;

export class Rights {
  /** Whether it may drive, unlock and change settings. An older daemon does not tell, and refuses later. */
  canDrive = true;

  constructor(private readonly onChange: () => void) {}

  setRole(role: string | null): void {
    const canDrive = role !== "read";
    if (canDrive === this.canDrive) return;
    this.canDrive = canDrive;
    if (!canDrive) notice("done", "This token has the role read: you can watch and stop robots.", SHOWN_MS);
    this.onChange();
  }
}
