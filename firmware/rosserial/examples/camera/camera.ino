// A picture that is larger than the node's buffer, like one of an ESP32-CAM: publish() refuses it with -1, and the
// board continues. A whole picture needs a node with room for it, OUTPUT_SIZE below: at most 64 KB, the limit of
// rosserial.
#include <ros.h>
#include <sensor_msgs/CompressedImage.h>

uint8_t picture[4096];  // from the camera's driver

ros::NodeHandle_<ArduinoHardware, 25, 25, 128, 2048> nh;
sensor_msgs::CompressedImage image;
ros::Publisher publisher("image/compressed", &image);
unsigned long published_at = 0;

void publish(uint32_t bytes) {
  image.header.stamp = nh.now();
  image.data_length = bytes;
  if (publisher.publish(&image) < 0) nh.logwarn("the picture is larger than the buffer");
}

void setup() {
  nh.initNode();
  nh.advertise(publisher);
  image.header.frame_id = "camera";
  image.format = "jpeg";
  image.data = picture;
}

void loop() {
  nh.spinOnce();
  if (!nh.connected() || millis() - published_at < 500) return;
  published_at = millis();
  publish(sizeof picture);  // refused
  publish(1000);            // fits
}
