/** A topic of the chosen robot, subscribed to while its device has it. */

import type { Connection } from "./connection";
import { type LinkView, type RobotView, topicOf } from "./views";

export class Followed<Message> {
  /** Name of the subscribed topic; "" for none. */
  topic = "";

  private stop = () => {};

  /** `onOther` is called when the topic changes, or there is none. */
  constructor(
    private readonly connection: Connection,
    private readonly leaf: string,
    private readonly type: string,
    private readonly onMessage: (message: Message) => void,
    private readonly onOther: () => void,
  ) {}

  show(robot: RobotView | undefined, link: LinkView | undefined): void {
    const found = robot ? topicOf(robot, link, this.leaf, this.type) : null;
    const wanted = found ?? (robot?.connected && link ? "" : this.topic);
    if (wanted === this.topic) return;
    this.onOther();
    this.stop();
    this.topic = wanted;
    this.stop = wanted ? this.connection.subscribe<Message>(wanted, this.type, this.onMessage) : () => {};
  }
  end(): void {
    this.stop();
    this.topic = "";
    this.stop = () => {};
  }
}
