// Calls std_srvs/Trigger on "trigger" each second without waiting: a call without an answer ends after half a
// second.
#include <ros.h>
#include <std_msgs/String.h>
#include <std_srvs/Trigger.h>

ros::NodeHandle nh;
ros::ServiceClient<std_srvs::Trigger::Request, std_srvs::Trigger::Response> client("trigger");
std_msgs::String text;
ros::Publisher chatter("chatter", &text);
unsigned long called_at = 0;

void receive(const std_srvs::Trigger::Response* response) {
  text.data = response == nullptr ? "no answer" : response->message;
  chatter.publish(&text);
}

void setup() {
  nh.initNode();
  nh.serviceClient(client);
  nh.advertise(chatter);
}

void loop() {
  nh.spinOnce();
  if (!nh.connected() || millis() - called_at < 1000) return;
  called_at = millis();
  std_srvs::Trigger::Request request;
  client.begin(request, &receive, 500);
}
