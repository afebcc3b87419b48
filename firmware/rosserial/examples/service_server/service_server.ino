// A service that switches the LED: std_srvs/SetBool on "switch_led".
#include <ros.h>
#include <std_srvs/SetBool.h>

ros::NodeHandle nh;

void set_led(const std_srvs::SetBool::Request& request, std_srvs::SetBool::Response& response) {
  digitalWrite(LED_BUILTIN, request.data ? HIGH : LOW);
  response.success = true;
  response.message = request.data ? "on" : "off";
}

ros::ServiceServer<std_srvs::SetBool::Request, std_srvs::SetBool::Response> server("switch_led", &set_led);

void setup() {
  pinMode(LED_BUILTIN, OUTPUT);
  nh.initNode();
  nh.advertiseService(server);
}

void loop() { nh.spinOnce(); }
