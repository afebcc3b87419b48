/** A form for a message, built from its type as rosapi describes it. */

import { make } from "./dom";
import { makeField } from "./widgets";

const MAX_FIELDS = 200;
const SCALAR = -1; // array length of a scalar

/** rosapi/TypeDef. */
export interface TypeDef {
  type: string;
  fieldnames: string[];
  fieldtypes: string[];
  fieldarraylen: number[];
}

interface Part {
  element: HTMLElement;
  read: () => unknown; // throws an Error with the reason
}

const INTEGERS: Record<string, [least: number, most: number]> = {
  int8: [-128, 127],
  uint8: [0, 255],
  byte: [-128, 127],
  char: [0, 255],
  int16: [-32768, 32767],
  uint16: [0, 65535],
  int32: [-2147483648, 2147483647],
  uint32: [0, 4294967295],
  int64: [Number.MIN_SAFE_INTEGER, Number.MAX_SAFE_INTEGER],
  uint64: [0, Number.MAX_SAFE_INTEGER],
};

export class MessageForm {
  readonly element: HTMLElement;

  private readonly types: Map<string, TypeDef>;
  private readonly root: Part;
  private count = 0;

  /** The first TypeDef is that of the message. */
  constructor(typedefs: TypeDef[]) {
    this.types = new Map(typedefs.map((each) => [each.type, each]));
    this.root = this.makeMessage(typedefs[0]?.type ?? "", "");
    this.element = make("div", { class: "message" }, this.root.element);
  }

  /** The message. Throws an Error that names the invalid field. */
  read(): object {
    return this.root.read() as object;
  }

  private makeMessage(type: string, path: string): Part {
    const { fieldnames = [], fieldtypes = [], fieldarraylen = [] } = this.types.get(type) ?? {};
    const parts = fieldnames.map((name, index): [string, Part] => {
      const at = path === "" ? name : `${path}.${name}`;
      return [name, this.makePart(fieldtypes[index] ?? "", fieldarraylen[index] ?? SCALAR, name, at)];
    });
    const hint = fieldnames.length === 0 ? [make("p", { class: "hint" }, "This message has no fields.")] : [];
    return {
      element: make("div", { class: "fields" }, ...parts.map(([, { element }]) => element), ...hint),
      read: () => Object.fromEntries(parts.map(([name, part]) => [name, part.read()])),
    };
  }

  private makePart(type: string, length: number, name: string, path: string): Part {
    this.count += 1;
    if (length !== SCALAR || this.count > MAX_FIELDS) return jsonPart(type, length, name, path);
    if (this.types.has(type)) {
      const inner = this.makeMessage(type, path);
      const group = make("fieldset", {}, make("legend", {}, name), inner.element);
      return { element: group, read: inner.read };
    }
    return scalarPart(type, name, path);
  }
}

function scalarPart(type: string, name: string, path: string): Part {
  if (type === "bool") {
    const box = make("input", { type: "checkbox" });
    return { element: makeField(name, box), read: () => box.checked };
  }
  if (type === "string") {
    const text = make("input", { type: "text", maxlength: "10000" });
    return { element: makeField(name, text), read: () => text.value };
  }
  const range = INTEGERS[type];
  const limits: Record<string, string> = range
    ? { min: String(range[0]), max: String(range[1]), step: "1" }
    : { step: "any" };
  const input = make("input", { type: "number", value: "0", ...limits });
  return {
    element: makeField(name, input),
    read: () => {
      if (input.value === "" || !input.validity.valid) throw new Error(`${path}: ${reasonOf(input, type)}`);
      return input.valueAsNumber;
    },
  };
}

function reasonOf(input: HTMLInputElement, type: string): string {
  if (input.validity.rangeUnderflow || input.validity.rangeOverflow) return `${input.min} to ${input.max} fit ${type}.`;
  return `enter a number (${type}).`;
}

/** A field without a form of its own is written as JSON. */
function jsonPart(type: string, length: number, name: string, path: string): Part {
  const isArray = length !== SCALAR;
  const size = length > 0 ? String(length) : "";
  const text = make("input", { type: "text", value: isArray ? "[]" : "{}", spellcheck: "false" });
  return {
    element: makeField(`${name} (${type}${isArray ? `[${size}]` : ""}, as JSON)`, text),
    read: () => {
      let value: unknown;
      try {
        value = JSON.parse(text.value);
      } catch {
        throw new Error(`${path}: this is not JSON.`);
      }
      if (isArray && !Array.isArray(value)) throw new Error(`${path}: enter a list, for example [1, 2].`);
      return value;
    },
  };
}
