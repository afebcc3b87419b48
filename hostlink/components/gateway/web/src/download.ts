/** Files for download: the daemon's, and tables that the page makes. */

import { make } from "./dom";
import { notice } from "./notice";
import { reasonOf, refusalOf, request } from "./rest";
import { token } from "./token";

/** A link that downloads a file of the daemon. With a token the page fetches the file: a link cannot send a header. */
export function makeDownload(path: string, file: string): HTMLAnchorElement {
  const link = make("a", { href: path, download: file, class: "button" }, "Download");
  link.setAttribute("aria-label", `Download ${file}`);
  link.addEventListener("click", (event) => {
    if (token() === null) return;
    event.preventDefault();
    void fetchAndSave(path, file);
  });
  return link;
}

/** Save a table as CSV: RFC 4180, with a header line. */
export function saveCsv(file: string, names: string[], rows: Iterable<(number | string | null)[]>): void {
  const lines = [names, ...rows].map((row) => row.map(cell).join(","));
  save(new Blob([`${lines.join("\r\n")}\r\n`], { type: "text/csv" }), file);
}

function cell(value: number | string | null): string {
  if (value === null) return "";
  if (typeof value === "number") return String(value);
  const text = /^[=+\-@\t\r]/.test(value) ? `'${value}` : value; // a spreadsheet would execute it
  return /[",\r\n]/.test(text) ? `"${text.replaceAll('"', '""')}"` : text;
}

async function fetchAndSave(path: string, file: string): Promise<void> {
  try {
    const response = await request("GET", path, {});
    if (!response.ok) throw await refusalOf(response);
    save(await response.blob(), file);
  } catch (error) {
    notice("refused", `Download: ${reasonOf(error)}`, 5000);
  }
}

function save(content: Blob, file: string): void {
  const url = URL.createObjectURL(content);
  make("a", { href: url, download: file }).click();
  setTimeout(() => URL.revokeObjectURL(url), 60_000); // the browser reads it after the click
}
